"""The emulated screw: ramps, limits and homing against what a uniformly accelerated motion does."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.linear_stage.emulator import ACCELERATION_MM_S2, BACK_OFF_MM, FASTEST_MM_S, Axis


def axis_at(true_mm, *, homed=True):
    stops = []
    axis = Axis(60.0, true_mm, lambda which, now_s: stops.append((which, now_s)))
    if homed:
        axis.homed, axis._count_from_mm = True, 0.0
    return axis, stops


def run(axis, until_s, from_s=10.0, counts=lambda axis: 0):
    now_s = from_s
    while now_s < until_s:
        now_s += 0.005
        axis.advance(now_s, counts(axis))
    return now_s


@settings(max_examples=25)
@given(st.floats(1, 59), st.floats(1, 59), st.floats(0.2, FASTEST_MM_S))
def test_a_move_arrives_exactly_and_in_the_time_of_a_trapezoid(from_mm, to_mm, speed_mm_s):
    axis, stops = axis_at(from_mm)
    axis.advance(10.0, 0)
    axis.go(to_mm, speed_mm_s)
    way_mm = abs(to_mm - from_mm)
    least_s = way_mm / speed_mm_s
    run(axis, 10.0 + least_s * 0.98 - 0.01)
    assert axis.moving or way_mm < 0.05
    run(axis, 10.0 + least_s + 2 * speed_mm_s / ACCELERATION_MM_S2 + 0.3)
    assert not axis.moving
    assert axis.count_mm == pytest.approx(to_mm, abs=1 / 1600)
    assert stops == []


def test_homing_ends_a_little_above_the_switch_and_counts_from_there():
    axis, stops = axis_at(12.0, homed=False)
    assert axis.count_mm == 0.0
    axis.advance(10.0, 0)
    axis.seek()
    run(axis, 14.0)
    assert axis.homed and not axis.moving
    assert axis.count_mm == pytest.approx(BACK_OFF_MM, abs=0.01)
    assert axis.true_mm == pytest.approx(axis.count_mm, abs=1e-3)
    assert stops == []


@pytest.mark.parametrize(("speed", "which", "end"), [(8.0, "HIGH", 60.0), (-8.0, "LOW", 0.0)])
def test_an_end_switch_stops_at_once_and_lets_back(speed, which, end):
    axis, stops = axis_at(30.0)
    axis.advance(10.0, 0)
    axis.run(speed)
    run(axis, 16.0)
    assert [cause for cause, _ in stops] == [which]
    assert axis.true_mm == pytest.approx(end, abs=0.02)
    assert axis.may_move(speed) == which
    assert axis.may_move(-speed) == ""


def test_a_force_limit_stops_at_once_lets_back_only_and_ends_when_the_force_has_gone():
    axis, stops = axis_at(30.0)
    axis.most_counts = 1000

    def counts(axis):
        return int(500 * (axis.true_mm - 30.0))

    axis.advance(10.0, 0)
    axis.run(2.0)
    now_s = run(axis, 13.0, counts=counts)
    assert [cause for cause, _ in stops] == ["FORCE"]
    assert axis.true_mm == pytest.approx(32.0, abs=0.02)
    assert axis.force_limit
    assert axis.may_move(1.0) == "FORCE"
    assert axis.may_move(-1.0) == ""
    axis.run(-2.0)
    run(axis, now_s + 0.5, from_s=now_s, counts=counts)
    assert len(stops) == 1
    assert not axis.force_limit
    assert axis.true_mm < 31.5


def test_a_stop_slows_down_and_a_halt_does_not():
    for stop, way_mm in ((Axis.brake, 8.0**2 / (2 * ACCELERATION_MM_S2)), (Axis.halt, 0.0)):
        axis, _ = axis_at(10.0)
        axis.advance(10.0, 0)
        axis.run(8.0)
        now_s = run(axis, 11.0)
        here_mm = axis.true_mm
        stop(axis)
        run(axis, now_s + 0.5, from_s=now_s)
        assert not axis.moving
        assert axis.true_mm - here_mm == pytest.approx(way_mm, abs=0.01)
