"""Work of a torque through an angle, extremes of cycles with their interval, shares of time: against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.devices import Trajectory
from labrun.errors import ExperimentError, SpecError
from labrun.experiment import ObjectiveTable
from labrun.objectives import Signal, TrialSignals, make_objective
from labrun.objectives.extremes import Extremes, ShareOfTime, smoothed
from labrun.objectives.work import Work, split_work

PERIOD_S = 0.5


def trial(torque, angle, *, cycles=4, discard=1, rate_hz=2000.0, angle_hz=700.0):
    """Return a trial of a torque and an angle that are given over the phase of a cycle, seen at rates of their own."""
    end_s = cycles * PERIOD_S
    when = {"wrench.torque_z": np.arange(-0.1, end_s + 0.1, 1 / rate_hz)}
    when["cameras.link"] = np.arange(-0.1, end_s + 0.1, 1 / angle_hz)
    phase = {name: 2 * math.pi * time_s / PERIOD_S for name, time_s in when.items()}
    shapes = {"wrench.torque_z": (torque, "N m"), "cameras.link": (angle, "rad")}
    signals = {
        name: Signal(time_s, shapes[name][0](phase[name]), shapes[name][1]) for name, time_s in when.items()
    }
    command_s = np.arange(0.0, end_s + 1e-9, 0.001)
    command = Trajectory(("wing",), command_s, angle(2 * math.pi * command_s / PERIOD_S)[:, None], PERIOD_S)
    return TrialSignals(signals, command, 0.0, end_s, PERIOD_S, discard)


def work(signals, **keys):
    return Work("wrench.torque_z", {"over": "cameras.link", **keys})(signals)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 3), st.floats(0.05, 1.2), st.floats(-0.9, 0.9))
def test_a_torque_in_phase_with_the_rate_does_the_work_of_its_half_waves(torque, angle, share):
    """Of (1 + share sign) T cos over A sin: pi A T (1 + share)/2 forth, pi A T (1 - share)/2 back."""
    signals = trial(
        lambda p: torque * np.cos(p) * (1 + share * np.sign(np.cos(p))), lambda p: angle * np.sin(p)
    )
    up, down = (0.5 * math.pi * torque * angle * (1 + side * share) for side in (1, -1))
    near = {"rel": 2e-3, "abs": 1e-4}
    assert work(signals, part="positive") == pytest.approx(up, **near)
    assert work(signals, part="negative") == pytest.approx(down, **near)
    assert work(signals, part="net") == pytest.approx(up - down, **near)
    assert work(signals, part="total") == pytest.approx(up + down, **near)
    assert work(signals, part="efficiency") == pytest.approx(100 * abs(share), abs=0.3)


def test_of_a_spring_all_work_is_given_back_and_by_force_nothing_is_left_over():
    signals = trial(lambda p: 0.8 * np.sin(p), lambda p: 0.5 * np.sin(p))
    for by in ("power", "force"):
        assert work(signals, part="net", by=by) == pytest.approx(0.0, abs=1e-5)
        assert work(signals, part="positive", by=by) == pytest.approx(0.8 * 0.5, rel=1e-3)


def test_what_a_drive_puts_in_is_told_by_power_and_is_what_friction_takes():
    signals = trial(lambda p: 0.3 * np.sign(np.cos(p)), lambda p: 0.5 * np.sin(p))
    assert work(signals, part="positive", by="power") == pytest.approx(4 * 0.5 * 0.3, rel=2e-3)
    assert work(signals, part="negative", by="power") == pytest.approx(0.0, abs=1e-3)
    assert work(signals, part="net", by="force") == pytest.approx(0.0, abs=1e-3)


def test_the_angle_that_was_told_stands_in_for_one_that_nothing_measures():
    signals = trial(lambda p: 0.4 * np.cos(p), lambda p: 0.6 * np.sin(p))
    message = Work("wrench.torque_z", {"over_command": "wing", "part": "positive"})
    assert message(signals) == pytest.approx(0.5 * math.pi * 0.4 * 0.6, rel=1e-3)
    with pytest.raises(ExperimentError, match="wnig"):
        Work("wrench.torque_z", {"over_command": "wnig"})(signals)


def test_an_interval_in_which_the_force_turns_round_is_divided_where_it_does():
    up, down = split_work(np.array([3.0, -1.0]), np.array([0.0, 1.0]), "force")
    assert (up, down) == pytest.approx((0.75 * 1.5, 0.25 * 0.5))


@pytest.mark.parametrize(
    "keys", [{}, {"over": "cameras.link", "over_command": "wing"}, {"over": "x.y", "part": "half"}]
)
def test_a_work_without_one_way_or_with_an_unknown_part_is_refused(keys):
    with pytest.raises(SpecError):
        make_objective("work", ObjectiveTable(plugin="work", channel="wrench.torque_z", settings=keys))


def test_units_follow_what_is_given():
    assert Work("a.b", {"over": "c.d"}).unit("N m") == "J"
    assert Work("a.b", {"over": "c.d", "part": "efficiency"}).unit("N m") == "%"
    assert Extremes("a.b", {}).unit("N m") == "N m"
    assert ShareOfTime("a.b", {"above": 0.0}).unit("N m") == "%"


def test_extremes_are_those_of_each_cycle_and_their_interval_is_students():
    heights = np.array([9.0, 1.0, 2.0, 4.0])  # the first cycle is discarded
    signals = trial(
        lambda p: heights[np.clip((p / (2 * math.pi)).astype(int), 0, 3)] * np.sin(p), lambda p: p, cycles=4
    )
    largest = {give: Extremes("wrench.torque_z", {"give": give})(signals) for give in ("mean", "ci95")}
    assert largest["mean"] == pytest.approx(heights[1:].mean(), rel=1e-4)
    # t of 2 degrees of freedom at 97.5 %: 4.302653
    assert largest["ci95"] == pytest.approx(4.302653 * heights[1:].std(ddof=1) / math.sqrt(3), rel=1e-4)
    smallest = Extremes("wrench.torque_z", {"which": "smallest", "scale": -1})(signals)
    assert smallest == pytest.approx(-heights[1:].mean(), rel=1e-4)
    span = Extremes("wrench.torque_z", {"which": "range"})(signals)
    assert span == pytest.approx(2 * heights[1:].mean(), rel=1e-4)


def test_an_interval_over_one_cycle_is_refused_and_says_what_to_do():
    signals = trial(np.sin, np.sin, cycles=2)
    with pytest.raises(ExperimentError) as refused:
        Extremes("wrench.torque_z", {"give": "ci95"})(signals)
    assert "trial.cycles" in str(refused.value.hint)


def test_noise_adds_to_an_extreme_and_smoothing_takes_it_off_again():
    rng = np.random.default_rng(1)
    signals = trial(lambda p: np.sin(p) + 0.2 * rng.standard_normal(len(p)), np.sin, cycles=6)
    rough, smooth = (Extremes("wrench.torque_z", {"smooth_s": smooth_s})(signals) for smooth_s in (0.0, 0.05))
    assert rough > 1.3
    assert smooth == pytest.approx(1.0, abs=0.05)


def test_smoothing_leaves_a_straight_line_as_it_is():
    time_s = np.sort(np.random.default_rng(0).uniform(0, 1, 200))
    assert smoothed(time_s, 3 * time_s - 1, 0.1) == pytest.approx(3 * time_s - 1, abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.95, 0.95))
def test_a_sine_is_above_a_level_for_as_long_as_its_arc(level):
    signals = trial(np.sin, np.sin)
    above = ShareOfTime("wrench.torque_z", {"above": level})(signals)
    below = ShareOfTime("wrench.torque_z", {"below": level})(signals)
    assert above == pytest.approx(100 * math.acos(level) / math.pi, abs=0.1)
    assert above + below == pytest.approx(100.0)


def test_of_two_channels_the_difference_counts():
    signals = trial(lambda p: 2 * np.sin(p), np.sin)
    bent = ShareOfTime("wrench.torque_z", {"above": 0.5, "less": "cameras.link"})(signals)
    assert bent == pytest.approx(100 / 3, abs=0.2)
