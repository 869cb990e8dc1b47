"""The worst case of a steered gait, before anything moves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.devices import Limits
from labrun.errors import SpecError
from labrun.experiment import GaitTable, Track
from labrun.gaits import make_gait, steering_of
from labrun.runner.motion import envelope


def worst(joints, *, plugin="sine", let=None, rate_hz=20.0, duration_s=5.0, condition=None, **loops):
    gait = make_gait(GaitTable(plugin=plugin, joints=joints, let=let or {}))
    tables = {
        name: {
            "drives": name,
            "reference": {"plugin": "constant"},
            "feedback": {"plugin": "latest"},
            "controllers": {"P": {"plugin": "pid"}},
            **loop,
        }
        for name, loop in loops.items()
    }
    track = Track(rate_hz=rate_hz, conditions=[{"controller": "P"}], loops=tables)
    return envelope(track, gait, plugin, condition or {}, duration_s=duration_s, rate_hz=100.0)


@given(st.floats(0.5, 3), st.floats(5, 60), st.floats(1, 200))
def test_a_steered_amplitude_is_at_worst_what_the_derivative_says(frequency_hz, high, slew):
    point = worst(
        {"tail": {"amplitude_deg": "a", "frequency_hz": frequency_hz}},
        a={"range": (1.0, high), "slew_per_s": slew},
    )
    omega = 2 * math.pi * frequency_hz
    # |a w cos| + |da/dt sin| is at most the root of the squares.
    assert point.speed_deg_s[0] == pytest.approx(math.hypot(omega * high, slew), rel=1e-4)
    assert (point.low_deg[0], point.high_deg[0]) == pytest.approx((-high, high), rel=1e-4)


def test_without_a_slew_rate_the_range_may_be_crossed_in_one_step():
    point = worst({"tail": {"angle_deg": "u"}}, plugin="hold", u={"range": (-10.0, 20.0)}, rate_hz=50.0)
    assert point.speed_deg_s[0] == pytest.approx(30.0 * 50.0)
    assert (point.low_deg[0], point.high_deg[0]) == pytest.approx((-10.0, 20.0))


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_nothing_that_loops_can_do_is_beyond_the_envelope(seed):
    """Random drives within range and slew, on a gait of two joints and two loops, sampled as a command is."""
    rng = np.random.default_rng(seed)
    joints = {
        "one": {"offset_deg": "b", "amplitude_deg": "a", "frequency_hz": 1.4},
        "two": {"offset_deg": "-b / 2", "amplitude_deg": "swing", "frequency_hz": 0.7, "phase_deg": 30},
    }
    let = {"swing": "a - abs(b)"}
    point = worst(
        joints,
        let=let,
        a={"range": (20.0, 40.0), "slew_per_s": 50.0},
        b={"range": (-15.0, 15.0), "slew_per_s": 80.0},
    )
    time_s = np.linspace(0, 5, 501)
    drives = {}
    for name, low, high, slew in (("a", 20, 40, 50), ("b", -15, 15, 80)):
        value, row = low, []
        for _ in range(101):
            row.append(value)
            value = min(max(value + slew * 0.05 * rng.uniform(-1, 1) * rng.integers(0, 2) * 1.0, low), high)
        drives[name] = np.interp(time_s, np.arange(101) * 0.05, row)
    gait = make_gait(GaitTable(plugin="sine", joints=joints, let=let))
    angle = np.degrees(steering_of(gait, "sine", {}, ["a", "b"])(time_s, drives))
    assert np.all(angle >= point.low_deg - 1e-6)
    assert np.all(angle <= point.high_deg + 1e-6)
    assert np.all(np.abs(np.diff(angle, axis=0)).max(axis=0) / 0.01 <= point.speed_deg_s * 1.001)


def test_an_excess_names_joint_value_and_bound():
    point = worst(
        {"tail": {"amplitude_deg": "a", "frequency_hz": 1.4}}, a={"range": (20.0, 62.0), "slew_per_s": 60.0}
    )
    excess = [str(item) for item in point.excess(("tail",), Limits(angle_deg=(-60, 60), speed_deg_s=528))]
    assert len(excess) == 3
    assert "worst angle of tail 62 deg is above the limit of 60 deg" in excess
    assert "worst speed of tail 548.7 deg/s is above the limit of 528 deg/s" in excess
    assert not point.excess(("tail",), Limits(angle_deg=(-62, 62), speed_deg_s=549))


def test_a_formula_that_depends_on_time_is_looked_at_over_the_whole_motion():
    joints = {"tail": {"angle_deg": "u + 0.5 * t", "frequency_hz": 1.0}}
    point = worst(joints, plugin="formula", duration_s=60.0, u={"range": (0.0, 1.0), "slew_per_s": 1.0})
    assert point.high_deg[0] == pytest.approx(31.0)


def test_a_gait_that_cannot_be_steered_says_which_can():
    with pytest.raises(SpecError, match="formula, hold and sine"):
        worst({"tail": {"angle_deg": 3}}, plugin="release", u={"range": (0.0, 1.0)})
