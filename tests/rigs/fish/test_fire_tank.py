"""The fish with two five-bars: symmetry, drag, current, carriage, and a landscape worth searching."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.rigs.fish.scene import FireTank
from simulated_bench import HandClock, device

from labrun.devices import Trajectory

AXES = ["force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z"]


def _mean_load(gait, *, side=1.0, noise=0.0, seed=0, tow_m_s=0.0, cycles=4):
    """Mean six-axis load of a gait (amplitudes, offsets, frequency, phase; deg); `side` -1 turns, +1 swims ahead."""
    a1, a2, b1, b2, frequency_hz, phase_deg = gait
    tank = FireTank({"noise": noise}, np.random.default_rng(seed))
    tank.observe(AXES, np.array([0.0]))
    if tow_m_s:
        tank.tow(0.0, 5.0, tow_m_s, 0.0)
    end_s = cycles / frequency_hz
    time_s = np.linspace(0.0, end_s, round(100 * end_s) + 1)
    turn = 2 * np.pi * frequency_hz * time_s
    first, second = b1 + a1 * np.sin(turn), b2 + a2 * np.sin(turn + np.radians(phase_deg))
    for joint, angle in [
        ("right_1", first),
        ("right_2", second),
        ("left_1", side * first),
        ("left_2", side * second),
    ]:
        ramp = np.radians([[0.0], [angle[0]]])
        tank.drive(joint, Trajectory((joint,), np.array([0.0, 1.0]), ramp), 0.5)
        tank.drive(joint, Trajectory((joint,), time_s, np.radians(angle)[:, None], 1 / frequency_hz), 3.0)
    return tank.observe(AXES, 3.0 + np.arange(1 / frequency_hz, end_s - 1e-9, 0.005)).mean(axis=0)


GAITS = st.tuples(
    st.floats(0, 60),
    st.floats(0, 60),
    st.floats(-40, 40),
    st.floats(-40, 40),
    st.floats(0.5, 1.5),
    st.floats(-180, 180),
)


@settings(max_examples=15, deadline=None)
@given(gait=GAITS)
def test_a_symmetric_gait_gives_no_side_force_no_roll_and_no_yaw(gait):
    load = _mean_load(gait)
    scale = np.abs(load).max() + 1e-9
    np.testing.assert_allclose(load[[1, 3, 5]] / scale, 0.0, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(gait=GAITS)
def test_the_mirrored_turning_gait_turns_as_hard_the_other_way(gait):
    load = _mean_load(gait, side=-1.0)
    mirrored = _mean_load((-gait[0], -gait[1], -gait[2], -gait[3], gait[4], gait[5]), side=-1.0)
    np.testing.assert_allclose(mirrored[[1, 3, 5]], -load[[1, 3, 5]], atol=1e-9)
    np.testing.assert_allclose(mirrored[[0, 2, 4]], load[[0, 2, 4]], atol=1e-9)


def test_random_turning_gaits_hardly_turn_and_a_search_has_something_to_find():
    rng = np.random.default_rng(1)
    torques = []
    for _ in range(150):
        a1, a2 = rng.uniform(0, 60, 2)
        b1, b2 = rng.uniform(-1, 1, 2) * (70 - np.array([a1, a2]))
        gait = (a1, a2, b1, b2, rng.uniform(0.2, 1.2), rng.uniform(-180, 180))
        torques.append(_mean_load(gait, side=-1.0)[5])
    good = max(
        _mean_load((38, 40, 23, -18, 1.5, 60), side=-1.0)[5],
        _mean_load((40, 41, -24, 23, 1.4, -64), side=-1.0)[5],
    )
    assert abs(np.median(torques)) < 0.05 * good
    assert np.median(np.abs(torques)) < 0.25 * good
    assert 0.005 < good < 0.5


def test_two_different_gaits_turn_the_same_way_so_the_landscape_has_several_peaks():
    first, other = (38, 40, 23, -18, 1.4, 60), (40, 41, -24, 23, 1.4, -64)
    between = tuple(np.mean([first, other], axis=0))
    torques = [_mean_load(gait, side=-1.0)[5] for gait in (first, other, between)]
    assert min(torques[:2]) > 3 * abs(torques[2])


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6])
def test_neutral_drag_is_about_the_measured_one(speed):
    tank = FireTank({"noise": 0}, np.random.default_rng(0))
    tank.tow(0.0, 5.0, speed, 0.0)
    load = tank.observe(AXES, np.arange(3.0, 5.0, 0.01)).mean(axis=0)
    assert -load[0] == pytest.approx(5.43 * speed**2, rel=0.15)
    assert load[4] == pytest.approx(-0.15 * load[0], abs=0.1 * abs(load[0]))  # the sensor sits above


def test_a_current_changes_what_a_gait_is_worth():
    gaits = [(38, 40, 23, -18, 1.4, 60), (40, 41, -24, 23, 1.4, -64)]
    still = np.array([_mean_load(gait, side=-1.0)[5] for gait in gaits])
    current = np.array([_mean_load(gait, side=-1.0, tow_m_s=0.1)[5] for gait in gaits])
    assert np.abs(current - still).max() > 0.1 * np.abs(still).max()


def test_the_carriage_travels_at_its_speed_between_two_ramps():
    tank = FireTank({"noise": 0}, np.random.default_rng(0))
    tank.tow(0.0, 0.4, 0.1, 1.0)
    time_s = np.arange(0.0, 8.0, 0.01)
    position = tank.observe(["position"], time_s)[:, 0]
    assert position[-1] == pytest.approx(0.4)
    speed = np.gradient(position, time_s)
    np.testing.assert_allclose(speed[(time_s > 1.3) & (time_s < 4.9)], 0.1, rtol=1e-6)
    assert speed.max() < 0.1001


def test_the_tail_pushes_forward_and_not_aside():
    tank = FireTank({"noise": 0}, np.random.default_rng(0))
    tank.observe(AXES, np.array([0.0]))
    time_s = np.linspace(0, 20 / 1.4, 3000)
    angle = np.radians(60 * np.sin(2 * np.pi * 1.4 * time_s))
    tank.drive("tail", Trajectory(("tail",), time_s, angle[:, None]), 0.0)
    load = tank.observe(AXES, np.arange(10 / 1.4, 20 / 1.4, 0.005)).mean(axis=0)
    assert load[0] > 0.1
    assert abs(load[1]) < 0.02 * load[0]


def test_vortices_scatter_repeated_trials():
    torques = [
        _mean_load((38, 40, 23, -18, 1.4, 60), side=-1.0, noise=1.0, seed=seed)[5] for seed in range(12)
    ]
    assert 0.05 * np.mean(torques) < np.std(torques, ddof=1) < 0.3 * np.mean(torques)


@pytest.fixture(scope="module")
def records():
    """Wrench of random gaits of the shipped experiment's ranges, with the RC servos in between: (frequency, (n, 6))."""
    rng = np.random.default_rng(3)
    results = []
    while len(results) < 40:
        a1, a2 = rng.uniform(0, 45, 2)
        b1, b2 = rng.uniform(-30, 30, 2)
        if a1 + abs(b1) <= 60 and a2 + abs(b2) <= 60:
            results.append(_record((a1, a2, b1, b2, rng.uniform(0.3, 1.5), rng.uniform(-180, 180))))
    return results


def _record(gait):
    a1, a2, b1, b2, frequency_hz, phase_deg = gait
    tank = FireTank({"noise": 0}, np.random.default_rng(0))
    joints = {joint: {} for joint in tank.joints[:4]}
    servos = device("simulated-arduino-servo", "fins", {"port": "p", "joints": joints}, tank, HandClock())
    servos.open()
    tank.observe(AXES, np.array([0.0]))
    time_s = np.linspace(0.0, 3 / frequency_hz, round(300 / frequency_hz) + 1)
    turn = 2 * np.pi * frequency_hz * time_s
    first, second = b1 + a1 * np.sin(turn), b2 + a2 * np.sin(turn + np.radians(phase_deg))
    angle = np.radians(np.column_stack([first, second, -first, -second]))
    servos.follow(Trajectory(servos.joints, np.array([0.0, 1.0]), angle[0] * np.array([[0.0], [1.0]])), 0.5)
    servos.follow(Trajectory(servos.joints, time_s, angle, 1 / frequency_hz), 3.0)
    return frequency_hz, tank.observe(AXES, 3.0 + np.arange(1 / frequency_hz, 3 / frequency_hz, 0.008))


def test_no_gait_of_the_experiment_saturates_its_sensor(records):
    peaks = np.max([np.abs(record).max(axis=0) for _, record in records], axis=0)
    assert peaks[:3].max() < 80
    assert peaks[3:].max() < 4


def test_yaw_torque_is_smooth_so_that_servo_pulses_and_the_flat_state_leave_no_spikes(records):
    for frequency_hz, record in records:
        yaw = record[:, 5] - record[:, 5].mean()
        power = np.abs(np.fft.rfft(yaw)) ** 2
        hz = np.fft.rfftfreq(len(yaw), 0.008)
        assert power[hz > 20].sum() < 0.01 * power.sum()
        assert power[hz <= 8.5 * frequency_hz].sum() > 0.9 * power.sum()
        step = np.abs(np.diff(yaw)).max()
        assert step < 0.25 * np.ptp(yaw)
