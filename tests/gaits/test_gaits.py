"""Gaits: from a condition to joint motion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import PluginError, SpecError
from labrun.experiment import GaitTable
from labrun.gaits import make_gait
from labrun.gaits.formula import FormulaGait
from labrun.gaits.release import HoldGait, ReleaseGait
from labrun.gaits.sine import SineGait, common_period_s
from labrun.gaits.there_and_back import RampGait, StaircaseGait

FIN = {"tail": {"offset_deg": "b", "amplitude_deg": "a", "frequency_hz": "f", "phase_deg": "phi"}}


@settings(max_examples=30)
@given(st.floats(-20, 20), st.floats(0, 40), st.floats(0.2, 3), st.floats(-180, 180), st.floats(0.1, 4))
def test_a_sine_is_offset_plus_amplitude_times_sine_in_radians(b, a, f, phi, duration_s):
    gait = SineGait(FIN, {}, {})
    motion = gait.trajectory({"b": b, "a": a, "f": f, "phi": phi}, duration_s=duration_s, rate_hz=100)
    assert motion.time_s[0] == 0
    assert motion.duration_s == pytest.approx(duration_s)
    assert np.diff(motion.time_s).max() <= 0.01 + 1e-12
    expected = np.radians(b + a * np.sin(2 * math.pi * f * motion.time_s + math.radians(phi)))
    np.testing.assert_allclose(motion.angle_rad[:, 0], expected, atol=1e-12)
    assert motion.period_s == gait.period_s({"b": b, "a": a, "f": f, "phi": phi}) == pytest.approx(1 / f)


def test_a_whole_number_of_steps_stays_one():
    gait = SineGait({"tail": {"amplitude_deg": 1, "frequency_hz": 1}}, {}, {})
    assert len(gait.trajectory({}, duration_s=0.07, rate_hz=100).time_s) == 8


def test_linked_joints_move_against_each_other():
    joints = {
        "right": {"amplitude_deg": "alpha", "offset_deg": "beta", "frequency_hz": "f"},
        "left": {"amplitude_deg": "-alpha", "offset_deg": "-beta", "frequency_hz": "f"},
    }
    motion = SineGait(joints, {}, {}).trajectory({"alpha": 30, "beta": 5, "f": 1}, duration_s=2, rate_hz=50)
    np.testing.assert_allclose(motion.only(("left",)).angle_rad, -motion.only(("right",)).angle_rad)


@settings(max_examples=30)
@given(st.integers(1, 9), st.integers(1, 9), st.floats(0.1, 3))
def test_the_common_period_holds_whole_cycles_of_every_joint_and_is_the_shortest(p, q, f):
    period = common_period_s([p * f, q * f])
    cycles = np.array([p * f, q * f]) * period
    np.testing.assert_allclose(cycles, np.round(cycles), atol=1e-6)
    assert math.gcd(*(round(count) for count in cycles)) == 1


def test_frequencies_without_a_common_cycle_have_no_period():
    assert common_period_s([1.0, math.pi]) is None


@pytest.mark.parametrize("frequency", [0, -1])
def test_a_frequency_that_is_not_above_zero_is_refused_with_its_key(frequency):
    gait = SineGait({"tail": {"amplitude_deg": 1, "frequency_hz": "f"}}, {}, {})
    with pytest.raises(SpecError, match=r"gait\.joints\.tail\.frequency_hz"):
        gait.trajectory({"f": frequency}, duration_s=1, rate_hz=10)


def test_a_formula_uses_time_the_condition_and_let_in_any_order():
    let = {"a": "20 + abs((40 - abs(b)) * sin(2*pi*0.004*t))", "b": "c * sin(2*pi*0.002*t)"}
    gait = FormulaGait({"tail": {"angle_deg": "b + a*sin(2*pi*1.4*t)", "frequency_hz": 1.4}}, let, {})
    motion = gait.trajectory({"c": 20}, duration_s=30, rate_hz=100)
    t = motion.time_s
    b = 20 * np.sin(2 * np.pi * 0.002 * t)
    a = 20 + np.abs((40 - np.abs(b)) * np.sin(2 * np.pi * 0.004 * t))
    np.testing.assert_allclose(
        np.degrees(motion.angle_rad[:, 0]), b + a * np.sin(2 * np.pi * 1.4 * t), atol=1e-9
    )
    assert motion.period_s == pytest.approx(1 / 1.4)


def test_a_formula_without_frequency_has_no_cycle():
    gait = FormulaGait({"tail": {"angle_deg": "3*t"}}, {}, {})
    assert gait.period_s({}) is None
    assert not FormulaGait.has_cycle({"tail": {"angle_deg": "3*t"}})


def test_a_formulas_frequency_may_come_from_let_but_not_from_time():
    assert (
        FormulaGait({"tail": {"angle_deg": "t", "frequency_hz": "g"}}, {"g": "2*f", "h": "t"}, {}).period_s(
            {"f": 1}
        )
        == 0.5
    )
    with pytest.raises(SpecError, match="depends on h, which a loop or time changes"):
        FormulaGait({"tail": {"angle_deg": "t", "frequency_hz": "h"}}, {"h": "1 + t"}, {}).period_s({})


@pytest.mark.parametrize("gait", [ReleaseGait, HoldGait])
@settings(max_examples=30)
@given(angle=st.floats(-90, 90))
def test_release_and_hold_command_one_angle_and_have_no_cycle(gait, angle):
    made = gait({"hinge": {"angle_deg": "2*half"}}, {}, {})
    motion = made.trajectory({"half": angle / 2}, duration_s=1, rate_hz=10)
    np.testing.assert_allclose(np.degrees(motion.angle_rad), angle, atol=1e-9)
    assert motion.period_s is None
    assert not gait.has_cycle({"hinge": {"angle_deg": 1}})


def test_keys_are_checked_when_the_gait_is_made():
    with pytest.raises(SpecError, match="amplitude is given in deg; write amplitude_deg"):
        SineGait({"tail": {"amplitude_rad": 1, "frequency_hz": 1}}, {}, {})
    with pytest.raises(SpecError, match="unknown key"):
        SineGait({"tail": {"amplitude_deg": 1, "frequency_hz": 1}}, {}, {"speed": 3})
    with pytest.raises(SpecError, match="something is missing"):
        HoldGait({"tail": {"angle_deg": "1 +"}}, {}, {})


@pytest.mark.parametrize("duration_s", [0, -1, math.inf, math.nan])
def test_a_motion_needs_a_duration(duration_s):
    with pytest.raises(SpecError, match="no duration"):
        HoldGait({"tail": {"angle_deg": 1}}, {}, {}).trajectory({}, duration_s=duration_s, rate_hz=10)


def test_a_gait_is_made_from_its_table_by_name_or_by_dotted_name():
    table = {"plugin": "sine", "joints": {"tail": {"amplitude_deg": 1, "frequency_hz": 2}}}
    assert make_gait(GaitTable.model_validate(table)).period_s({}) == 0.5
    assert make_gait(GaitTable.model_validate({**table, "plugin": "labrun.gaits.sine:SineGait"})).joints == (
        "tail",
    )
    with pytest.raises(PluginError, match="sine"):
        make_gait(GaitTable.model_validate({**table, "plugin": "sin"}))


@settings(max_examples=30)
@given(
    st.floats(-20, 20), st.floats(0.1, 30), st.sampled_from([-1, 1]), st.integers(1, 12), st.floats(0.1, 2)
)
def test_a_staircase_rests_on_every_step_there_and_back(start, way, sense, steps, hold_s):
    keys = {"from_deg": start, "to_deg": start + sense * way, "step_deg": way / steps, "hold_s": hold_s}
    gait = StaircaseGait({"bend": keys}, {}, {})
    assert gait.period_s({}) == pytest.approx(2 * steps * hold_s)
    middle_of_rests = gait.trajectory({}, duration_s=2 * steps * hold_s, rate_hz=10 / hold_s).at(
        (np.arange(2 * steps) + 0.5) * hold_s
    )
    climbed = np.concatenate([np.arange(steps), np.arange(steps, 0, -1)])
    expected = np.radians(start + sense * way / steps * climbed)
    np.testing.assert_allclose(middle_of_rests[:, 0], expected, atol=1e-9)


def test_a_ramp_goes_there_and_back_at_its_speed():
    gait = RampGait({"bend": {"to_deg": "reach", "speed_deg_s": 2}}, {}, {})
    motion = gait.trajectory({"reach": -10}, duration_s=10, rate_hz=10)
    assert gait.period_s({"reach": -10}) == 10
    assert np.degrees(motion.angle_rad[[0, 25, 50, 100], 0]) == pytest.approx([0, -5, -10, 0])
    assert np.degrees(motion.peak_speed_rad_s()) == pytest.approx([2])


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"to_deg": 5, "speed_deg_s": 0}, "speed_deg_s is 0; it must be above 0"),
        ({"to_deg": 0, "speed_deg_s": 1}, "goes from 0 deg to where it is"),
    ],
)
def test_a_ramp_that_goes_nowhere_is_refused(keys, complaint):
    with pytest.raises(SpecError, match=complaint):
        RampGait({"bend": keys}, {}, {}).period_s({})
