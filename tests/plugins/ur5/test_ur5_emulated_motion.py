import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.simulated.bench import ACCELERATION_M_S2
from labrun_plugins.simulated.bench import Carriage as Towed
from labrun_plugins.ur5.emulated_arm import ROUNDING_S, StraightMove, braking, half_way_s

HOME = np.array([-0.35, -0.4, 0.3, 0.0, 3.14, 0.0])
WAY = st.floats(1e-3, 0.8)
SPEED = st.floats(0.005, 0.5)


def straight(way_m, speed_m_s, acceleration_m_s2):
    goal = HOME.copy()
    goal[1] += way_m
    return StraightMove(HOME, goal, speed_m_s, acceleration_m_s2)


@given(WAY, SPEED)
def test_the_tool_moves_as_the_scenes_carriage_does(way_m, speed_m_s):
    move = straight(way_m, speed_m_s, ACCELERATION_M_S2)
    towed = Towed()
    towed.move(0.0, way_m, speed_m_s, 0.0)
    times = np.linspace(1e-6, 1.1 * move.duration_s, 50)
    position, speed, _ = towed.motion(times)
    for time_s, x, v in zip(times, position, speed, strict=True):
        pose, velocity = move.at(time_s)
        assert pose[1] - HOME[1] == pytest.approx(x, abs=1e-9)
        assert velocity[1] == pytest.approx(v, abs=1e-9)
        assert pose[[0, 2, 3, 4, 5]] == pytest.approx(HOME[[0, 2, 3, 4, 5]])


@given(WAY, SPEED)
def test_acceleration_rises_and_falls_at_a_constant_rate_and_the_way_stays_the_same(way_m, speed_m_s):
    towed = Towed()
    towed.move(0.0, way_m, speed_m_s, 0.0)
    times = np.linspace(0.0, straight(way_m, speed_m_s, ACCELERATION_M_S2).duration_s, 2001)
    position, speed, acceleration = towed.motion(times)
    jerk = ACCELERATION_M_S2 / ROUNDING_S
    assert np.abs(np.diff(acceleration)).max() <= 2.01 * jerk * times[1]  # twice where both ramps meet
    assert position[-1] == pytest.approx(way_m)
    assert speed[-1] == pytest.approx(0.0, abs=1e-12)
    assert np.trapezoid(speed, times) == pytest.approx(way_m, rel=1e-3)


@given(WAY, SPEED, st.floats(0.1, 3.0), st.floats(0.01, 0.99), st.floats(0.5, 10.0))
def test_braking_begins_where_and_as_fast_as_the_tool_is_and_ends_at_rest(way_m, speed, a, share, brake):
    move = straight(way_m, speed, a)
    pose, velocity = move.at(share * move.duration_s)
    stop = braking(pose, velocity, brake)
    assert stop is not None
    begin_s = half_way_s(stop)
    at_pose, at_velocity = stop.at(begin_s)
    assert at_pose == pytest.approx(pose, abs=1e-9)
    assert at_velocity == pytest.approx(velocity, abs=1e-6)
    assert stop.duration_s - begin_s == pytest.approx(velocity[1] / brake, rel=1e-6, abs=1e-9)
    end, rest = stop.at(stop.duration_s)
    assert end[1] - pose[1] == pytest.approx(velocity[1] ** 2 / (2 * brake), rel=1e-6, abs=1e-9)
    assert not rest.any()


def test_a_tool_at_rest_needs_no_braking_and_a_way_of_nothing_is_over_at_once():
    assert braking(HOME, np.zeros(6), 2.0) is None
    nowhere = StraightMove(HOME, HOME.copy(), 0.1, 0.5)
    assert nowhere.duration_s == 0.0
    assert nowhere.at(0.0)[0] == pytest.approx(HOME)
