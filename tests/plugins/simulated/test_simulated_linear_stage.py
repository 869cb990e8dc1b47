"""The stand-in of the stage: its counts and newtons, its limits, its stop."""

import numpy as np
import pytest
from labrun_plugins.rigs.beam.scene import BeamBench
from labrun_plugins.simulated.linear_stage import LoadCell, SimulatedLinearStageSettings
from simulated_bench import HandClock, StillScene, device, line

from labrun.devices import Actuator, Carriage, Sensor
from labrun.errors import DeviceError, LimitExceededError

CELL = {"slope_n_per_count": 4.676e-6, "offset_counts": 21400}
LIMITS = {"travel_m": [-0.02, 0.025], "speed_m_s": 0.005, "force_n": 7, "angle_deg": [-11, 14]}


def stage(scene=None, clock=None, **keys):
    table = {
        "port": "p",
        "calibration": CELL,
        "limits": LIMITS,
        "joints": {"bend": {"lever_mm": 100}},
        **keys,
    }
    scene = scene or BeamBench({"noise": 0}, np.random.default_rng(0))
    made = device("simulated-linear-stage", "stage", table, scene, clock or HandClock())
    made.open()
    return made


def test_it_can_what_the_driver_can():
    made = stage()
    assert isinstance(made, Carriage) and isinstance(made, Sensor) and isinstance(made, Actuator)
    assert made.joints == ("bend",)
    assert made.travel_m == (-0.02, 0.025)


def test_force_is_made_of_whole_counts_that_are_kept():
    clock = HandClock()
    made = stage(StillScene({"force": 2.5, "position": 0.004}), clock)
    made.start()
    clock.sleep(20.0)
    samples = made.read()
    displacement, force, counts = samples.values.T
    np.testing.assert_array_equal(counts, np.round(counts))
    np.testing.assert_allclose(force, 4.676e-6 * (counts - 21400), atol=1e-12)
    assert force.mean() == pytest.approx(2.5, abs=1e-4)
    assert force.std() == pytest.approx(60 * 4.676e-6, rel=0.1)
    np.testing.assert_allclose(displacement, 0.004, atol=1e-6)
    assert len(samples) + samples.lost == pytest.approx(1600, abs=2)


def test_without_calibration_there_are_counts_alone():
    made = stage(calibration=None, limits={})
    assert [channel.name for channel in made.channels] == ["displacement", "counts"]


@pytest.mark.parametrize("force_n", [50.0, -50.0])
def test_a_cell_beyond_its_range_is_clipped_and_counted(force_n):
    clock = HandClock()
    made = stage(StillScene({"force": force_n, "position": 0.0}), clock)
    made.start()
    clock.sleep(1.0)
    samples = made.read()
    assert samples.saturated == len(samples) > 70
    assert abs(samples.values[0, 2]) >= 8388607


def test_the_fault_saturate_clips_every_sample():
    clock = HandClock()
    made = stage(StillScene({"force": 0.0, "position": 0.0}), clock, faults={"saturate": True})
    made.start()
    clock.sleep(1.0)
    samples = made.read()
    assert samples.saturated == len(samples)
    assert set(samples.values[:, 2]) == {8388607.0}


def test_a_travel_and_a_motion_move_the_pusher_and_the_beam_answers():
    clock = HandClock()
    made = stage(clock=clock)
    made.travel(0.01, 0.005)
    clock.sleep(3.0)
    assert made.position_m() == pytest.approx(0.01)
    assert made.pose() == {"bend": pytest.approx(0.1)}
    made.follow(line("bend", [np.degrees(0.1), 0.0], [0.0, 4.0]), clock.now())
    clock.sleep(2.0)
    assert made.position_m() == pytest.approx(0.005, abs=1e-4)
    made.safe_stop()
    clock.sleep(2.0)
    assert made.position_m() == pytest.approx(0.005, abs=1e-4)


def test_homing_takes_it_to_its_switch_and_to_zero():
    clock = HandClock()
    scene = BeamBench({"noise": 0}, np.random.default_rng(0))
    made = stage(scene, clock, home_on_open=True)
    assert clock.now() == pytest.approx(2 * 30 / 5)
    assert made.position_m() == pytest.approx(0.0, abs=1e-9)
    made.start()
    clock.sleep(1.0)
    assert made.read().values[-1, 1] == pytest.approx(0.03, abs=2e-3)  # the loop remembers the way from below


@pytest.mark.parametrize(
    "motion",
    [
        line("bend", [0.0, 14.9], [0.0, 60.0]),
        line("bend", [0.0, -12.0], [0.0, 60.0]),
        line("bend", [0.0, 5.0], [0.0, 1.0]),
    ],
)
def test_a_motion_outside_a_limit_is_refused_whole(motion):
    made = stage()
    with pytest.raises(LimitExceededError, match=r"nothing was sent"):
        made.follow(motion, 0.0)
    assert made.position_m() == 0.0


@pytest.mark.parametrize(
    ("to_m", "speed_m_s"), [(0.026, 0.001), (-0.021, 0.001), (0.01, 0.006), (np.nan, 0.001), (0.01, 0.0)]
)
def test_a_travel_outside_a_limit_is_refused(to_m, speed_m_s):
    with pytest.raises(DeviceError, match="stage"):
        stage().travel(to_m, speed_m_s)


def test_another_joint_is_refused():
    with pytest.raises(DeviceError, match="bends bend"):
        stage().follow(line("tail", [0.0, 1.0], [0.0, 1.0]), 0.0)
    with pytest.raises(DeviceError, match="no joint"):
        stage(joints=None).follow(line("tail", [0.0, 1.0], [0.0, 1.0]), 0.0)


def test_a_bench_without_a_pusher_is_told():
    with pytest.raises(DeviceError, match="this bench has no position"):
        stage(StillScene({"force": 0.0}))


def test_ten_samples_a_second_are_quieter():
    quiet = LoadCell(SimulatedLinearStageSettings(port="p", rate_hz=10))
    loud = LoadCell(SimulatedLinearStageSettings(port="p", rate_hz=80))
    spread = [cell.counts(np.zeros(4000), np.random.default_rng(1)).std() for cell in (quiet, loud)]
    assert spread[1] > 2 * spread[0]
