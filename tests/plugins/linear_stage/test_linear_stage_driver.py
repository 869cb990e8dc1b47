"""The driver against its emulator, in two processes with a pty between them."""

import threading
from pathlib import Path

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.linear_stage.driver import LinearStage
from labrun_plugins.rigs.beam.scene import BeamBench
from labrun_plugins.simulated.linear_stage import SimulatedLinearStage
from stage_bench import SETTINGS, bend, commands

from labrun.devices import Actuator, Carriage, DeviceContext, DeviceError, Sensor
from labrun.errors import LimitExceededError
from labrun.runner import RealClock, SimulatedClock

SHARED = {**SETTINGS, "watchdog_ms": 400}
"""A patient watchdog: tests share their processors, and only the test of the watchdog is about it."""
OUT_AND_BACK = bend([0.0, 0.05, -0.012, 0.0], [0.0, 1.0, 2.3, 2.6])
_STOP_S = 0.1


@pytest.fixture(scope="module")
def dry_run():
    """Time from the motion's start and force by the stand-in. Compiles the scene, which would starve the watchdog."""
    clock = SimulatedClock()
    scene = BeamBench({"noise": 0}, np.random.default_rng(0))
    made = SimulatedLinearStage.Settings(**{**SETTINGS, "port": "/dev/null"})
    stage = SimulatedLinearStage("stage", made, DeviceContext(clock, np.random.default_rng(0), scene))
    stage.open()
    stage.start()
    stage.follow(OUT_AND_BACK, 1.0)
    clock.sleep(5.0)
    samples = stage.read()
    return samples.host_time_s - 0.005 - 1.0, samples.values[:, 1]


@pytest.fixture(scope="module")
def bench(dry_run):
    with emulated(
        "linear-stage", SHARED, name="stage", scene="beam-bench", scene_settings={"noise": 0}
    ) as running:
        running.driver.open()
        yield running


@pytest.fixture
def closed(bench):
    """The emulator, for a driver of the test's own; the shared one is open again for the next test."""
    bench.driver.close()
    yield bench
    bench.driver.close()
    bench.driver.open()


def _settings(bench, **changes):
    return LinearStage.Settings(**{**SHARED, **bench.bench.settings["stage"], **changes})


def _another(bench, settings):
    return LinearStage("stage", settings, DeviceContext(bench.clock, np.random.default_rng(0)))


def _restart(bench):
    """Have the board forget where it is."""
    begun_s = bench.clock.now()
    bench.inject("restart")
    bench.wait_for("booted", after_s=begun_s)


def _come_home(bench):
    bench.driver.travel(0.0, 0.008)
    bench.wait_until(lambda: abs(bench.driver.position_m()) < 2e-6)


def test_it_is_carriage_sensor_and_actuator(bench):
    for capability in (Carriage, Sensor, Actuator):
        assert isinstance(bench.driver, capability)
    assert [(channel.name, channel.unit) for channel in bench.driver.channels] == [
        ("displacement", "m"),
        ("force", "N"),
        ("counts", "1"),
    ]


def test_opening_homes_it_and_says_what_it_is(bench):
    assert [line["word"] for line in commands(bench)][:2] == ["HOME", "MV"]
    limits = bench.events("limits")[0]
    assert (limits["low_mm"], limits["high_mm"]) == (0.5, 22.0)
    assert limits["most_counts"] == int(7 / 4.676e-6 - 21400)
    identity = bench.driver.identify()
    assert identity.firmware == "labstage 1.0"
    assert identity.details["slope_n_per_count"] == "4.676e-06"
    assert identity.details["calibrated"] == "2026-03-02"
    assert bench.driver.health().ok
    assert bench.driver.position_m() == pytest.approx(0.0, abs=1e-6)


def test_a_followed_motion_is_that_of_the_dry_run_in_displacement_and_force(bench, dry_run):
    driver = bench.driver
    _come_home(bench)
    driver.start()
    start_s = bench.clock.now() + 0.2
    driver.follow(OUT_AND_BACK, start_s)
    blocks = []
    while bench.clock.now() < start_s + 2.8:
        bench.clock.sleep(0.05)
        blocks.append(driver.read())
    driver.stop()
    values = np.concatenate([block.values for block in blocks])
    device_s = np.concatenate([block.device_time_s for block in blocks])
    host_s = np.concatenate([block.host_time_s for block in blocks])
    assert sum(block.lost for block in blocks) == 0
    assert sum(block.saturated for block in blocks) == 0
    assert len(values) > 200
    np.testing.assert_allclose(np.diff(device_s), 0.0125, atol=1e-4)
    np.testing.assert_allclose(values[:, 1], 4.676e-6 * (values[:, 2] - 21400), atol=1e-9)

    # A sample was taken just before it was received: the least delayed one bounds the offset of the two clocks.
    taken_s = device_s + np.min(host_s - device_s) - start_s
    wanted_m = 0.1 * OUT_AND_BACK.at(taken_s)[:, 0]
    late = bench.driver.pacing()
    allowed_m = 2e-4 + 0.005 * (
        2 * late.late_worst_s + 0.05
    )  # the emulator, too, may have to wait for its turn
    assert np.max(np.abs(values[:, 0] - wanted_m)) < allowed_m

    # The beam is as stiff as 200 N/m; where the pusher homed leaves a loop of 2 x 0.03 N between the two.
    force_n = np.interp(taken_s, *dry_run)
    np.testing.assert_allclose(values[:, 1], force_n, atol=0.07 + 200 * allowed_m)
    assert values[:, 1].max() == pytest.approx(1.03, abs=0.1)


@pytest.mark.parametrize(
    "motion",
    [
        bend([0.0, 0.25], [0.0, 60.0]),  # 25 mm and 14 deg, where 20 mm and 11 deg are the end
        bend([0.0, -0.02], [0.0, 10.0]),  # -2 mm, where -1.5 mm is the end
        bend([0.0, 0.1], [0.0, 1.0]),  # 10 mm/s, where 8 is the most
        bend([0.0, 0.22], [0.0, 60.0]),  # 12.6 deg, where 11 is the most
    ],
)
def test_a_motion_outside_the_limits_is_never_sent(bench, motion):
    now_s = bench.clock.now()
    with pytest.raises(LimitExceededError, match=r"stage.*nothing was sent"):
        bench.driver.follow(motion, now_s)
    bench.clock.sleep(0.15)
    assert commands(bench, after_s=now_s) == []


@pytest.mark.parametrize(("to_m", "speed_m_s"), [(0.021, 0.005), (-0.0016, 0.005), (0.01, 0.009)])
def test_a_move_outside_the_limits_is_never_sent(bench, to_m, speed_m_s):
    now_s = bench.clock.now()
    with pytest.raises(LimitExceededError):
        bench.driver.travel(to_m, speed_m_s)
    assert commands(bench, after_s=now_s) == []


@pytest.mark.parametrize(
    ("to_m", "speed_m_s"), [(np.nan, 0.005), (0.01, 0.0), (0.01, -0.001), (0.01, np.inf)]
)
def test_a_move_that_is_none_is_refused(bench, to_m, speed_m_s):
    with pytest.raises(DeviceError, match="stage"):
        bench.driver.travel(to_m, speed_m_s)


def test_a_motion_of_another_joint_is_refused(bench):
    other = bend([0.0, 0.01], [0.0, 1.0]).__class__(("tail",), np.array([0.0]), np.array([[0.0]]))
    with pytest.raises(DeviceError, match="bends bend"):
        bench.driver.follow(other, bench.clock.now())


def test_a_stop_from_another_thread_reaches_the_board_at_once_and_nothing_moves_afterwards(bench):
    driver = bench.driver
    _come_home(bench)
    driver.follow(bend([0.0, 0.15], [0.0, 5.0]), bench.clock.now())
    bench.clock.sleep(0.4)
    asked = threading.Thread(target=lambda: [driver.health() for _ in range(20)])
    asked.start()
    stopped_s = bench.clock.now()
    driver.safe_stop()
    asked.join()
    seen = bench.wait_for("stop", after_s=stopped_s)
    assert seen["how"] == "STOP"
    assert seen["time_s"] - stopped_s < _STOP_S
    still = bench.wait_for("still", after_s=stopped_s)
    bench.clock.sleep(0.3)
    assert commands(bench, after_s=seen["time_s"]) == []
    assert 1e3 * driver.position_m() + 2 == pytest.approx(still["position_mm"], abs=1e-3)
    driver.safe_stop()  # any number of times
    _come_home(bench)


def test_the_equivalent_angle_is_displacement_over_lever(bench):
    bench.driver.travel(0.005, 0.008)
    bench.wait_until(lambda: abs(bench.driver.position_m() - 0.005) < 2e-6)
    assert bench.driver.pose() == {"bend": pytest.approx(0.05, abs=1e-4)}
    _come_home(bench)


def test_doctor_finds_nothing_to_mend_but_the_patient_watchdog(bench):
    remarks = bench.driver.examine()
    assert {remark.subject for remark in remarks} >= {
        "firmware",
        "watchdog",
        "state",
        "calibration",
        "load cell",
    }
    assert {remark.subject for remark in remarks if remark.verdict != "ok"} <= {"calibration", "watchdog"}
    assert "watchdog_ms = 100" in next(remark.advice for remark in remarks if remark.subject == "watchdog")


def test_reading_before_start_is_refused(bench):
    with pytest.raises(DeviceError, match="not streaming"):
        bench.driver.read()


def test_no_watchdog_expires_while_all_is_well(bench):
    assert bench.events("watchdog") == []


def test_a_runner_that_dies_in_motion_is_stopped_by_the_watchdog_and_stopped_again_from_scratch(closed):
    bench, settings = closed, _settings(closed, watchdog_ms=200)
    driver = _another(bench, settings)
    driver.open()
    driver.travel(0.018, 0.003)
    bench.wait_until(lambda: driver.position_m() > 5e-4)
    driver._motion.end()  # the process is gone: nobody feeds, nobody closes in order
    driver._session._port.close()
    died_s = bench.clock.now()
    expired = bench.wait_for("watchdog", after_s=died_s - 0.3)
    assert expired["silent_s"] < 0.2 + 0.2  # the emulator looks every few ms; its machine may be loaded
    stop = bench.wait_for("stop", after_s=expired["time_s"] - 1e-3)
    assert stop["how"] == "watchdog"
    assert stop["moving"] is True
    assert stop["position_mm"] < 2 + 18
    again_s = bench.clock.now()
    LinearStage.emergency_stop("stage", settings)
    assert bench.wait_for("stop", after_s=again_s)["how"] == "STOP"
    assert LinearStage.probe(settings.port).model == "labstage"


def test_a_stage_that_is_not_homed_says_so_and_does_not_move(closed):
    bench = closed
    _restart(bench)
    begun_s = bench.clock.now()
    driver = _another(bench, _settings(bench, home_on_open=False, calibration=None, limits={}))
    driver.open()
    assert [channel.name for channel in driver.channels] == ["displacement", "counts"]
    assert not driver.health().ok
    assert "not homed" in driver.health().notes[0]
    for move in (
        lambda: driver.travel(0.001, 0.001),
        lambda: driver.follow(bend([0.0, 0.01], [0.0, 1.0]), bench.clock.now()),
    ):
        with pytest.raises(DeviceError, match=r"stage: is not homed(.|\n)*home_on_open"):
            move()
    assert commands(bench, after_s=begun_s) == []
    driver.home()
    assert driver.health().ok
    assert driver.position_m() == pytest.approx(0.0, abs=1e-5)
    driver.close()


def test_a_doctor_does_not_home_it(closed):
    _restart(closed)
    begun_s = closed.clock.now()
    closed.driver.open_at_rest()
    assert closed.driver.health().ok  # a run homes it
    (state,) = [check for check in closed.driver.examine() if check.subject == "state"]
    assert "a run begins by seeking the lower end switch" in state.message
    assert commands(closed, after_s=begun_s) == []


def test_a_port_that_is_not_there_is_told_with_what_to_do():
    settings = LinearStage.Settings(**{**SETTINGS, "port": "/dev/nowhere"})
    driver = LinearStage("stage", settings, DeviceContext(RealClock(), np.random.default_rng(0)))
    with pytest.raises(
        DeviceError, match=r"device stage: cannot find the port /dev/nowhere(.|\n)*plug it in"
    ):
        driver.open()
    driver.safe_stop()
    driver.close()
    with pytest.raises(DeviceError, match="not open"):
        driver.identify()


def test_no_part_of_the_emulator_is_the_drivers():
    folder = Path(LinearStage.probe.__code__.co_filename).parent
    text = (folder / "emulator.py").read_text(encoding="utf-8")
    for own in ("linear_stage.reception", "linear_stage.motion", "labline.codec", "labline.session"):
        assert own not in text
