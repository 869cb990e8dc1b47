"""Joints that share no cycle: which part of a recording counts, and what the cycles it cuts can do to a mean."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from labrun.errors import ExperimentError
from labrun.experiment import CyclesOf, ObjectiveTable
from labrun.objectives import TrialSignals, make_objective
from labrun.objectives.window import RESIDUAL, averaging_window, left_over, truncation_bound
from labrun.signals import Signal

RATE_HZ = 125.0
HZ = st.floats(0.4, 1.5)
PHASE = st.floats(-np.pi, np.pi)


def signal_of(value, end_s):
    time_s = np.arange(0.0, end_s + 1.0 / RATE_HZ, 1.0 / RATE_HZ)
    return Signal(time_s, value(time_s), "N")


def trial(value, frequencies_hz, average, *, end_s=6.5, **keys):
    return TrialSignals(
        {"w.x": signal_of(value, end_s)},
        None,
        0.0,
        end_s,
        average=average,
        frequencies_hz=frequencies_hz,
        **keys,
    )


def measured(signals, plugin="mean"):
    objective = make_objective("thrust", ObjectiveTable(plugin=plugin, channel="w.x"))
    return objective(signals), objective.truncation(signals)


@settings(max_examples=30)
@given(HZ, PHASE, st.floats(3.0, 20.0))
def test_whole_cycles_of_one_joint_leave_nothing_of_its_motion(hz, phase, end_s):
    signals = trial(
        lambda t: 0.3 + 2.0 * np.sin(2 * np.pi * hz * t + phase),
        {"tail": hz},
        CyclesOf(cycles_of="tail"),
        end_s=end_s,
    )
    mean, cut = measured(signals)
    assert mean == pytest.approx(0.3, abs=0.005)
    assert cut < 0.005
    start_s, stop_s = signals.window()
    assert (stop_s - start_s) * hz == pytest.approx(round((stop_s - start_s) * hz))
    assert stop_s == end_s


@settings(max_examples=60)
@given(HZ, HZ, PHASE, PHASE, st.sampled_from(["beats", CyclesOf(cycles_of="tail")]))
def test_the_bound_holds_what_cut_cycles_do_to_a_force_that_goes_with_the_square_of_speed(
    one_hz, other_hz, one_phase, other_phase, average
):
    """(a sin p + b sin q)^2 = mean + lines at 2p, 2q, p + q and p - q: the mean is known."""

    def squared(t):
        return (
            np.sin(2 * np.pi * one_hz * t + one_phase) + 0.6 * np.sin(2 * np.pi * other_hz * t + other_phase)
        ) ** 2

    assume(abs(one_hz - other_hz) * 6.5 > 2.0)  # two beats are seen: of slower ones see below
    mean, cut = measured(trial(squared, {"tail": one_hz, "fin": other_hz}, average))
    assert abs(mean - 0.5 * (1 + 0.6**2)) <= 1.3 * cut + 0.01


def test_the_bound_of_a_single_line_is_the_kernel_of_the_window_times_its_amplitude():
    hz, length_s = 1.37, 6.2
    signal = signal_of(lambda t: 0.8 * np.sin(2 * np.pi * hz * t + 0.3), length_s)
    expected = 0.8 * abs(np.sin(np.pi * hz * length_s)) / (np.pi * hz * length_s)
    # Lines in between whose amplitude is only what leaks there add a little.
    assert truncation_bound(signal, [hz]) == pytest.approx(expected, rel=0.2)


def test_the_bound_dies_out_with_the_length_of_the_recording():
    def force(t):
        return (np.sin(2 * np.pi * 1.4 * t) + np.sin(2 * np.pi * 0.93 * t)) ** 2

    frequencies = {"tail": 1.4, "fin": 0.93}
    bounds = [
        measured(trial(force, frequencies, CyclesOf(cycles_of="tail"), end_s=end))[1] for end in (6, 60, 600)
    ]
    assert bounds[0] > 3 * bounds[1] > 9 * bounds[2]


@pytest.mark.parametrize("phase", np.linspace(0, 2 * np.pi, 9))
@pytest.mark.parametrize("other_hz", [1.37, 1.3, 1.15])
def test_the_bound_of_a_beat_that_is_too_slow_to_be_seen_is_no_less_than_what_it_does(other_hz, phase):
    def force(t):
        return (np.sin(2 * np.pi * 1.4 * t) + np.sin(2 * np.pi * other_hz * t + phase)) ** 2

    mean, cut = measured(trial(force, {"tail": 1.4, "fin": other_hz}, CyclesOf(cycles_of="tail")))
    # Of the slowest, 33 s long, 6.5 s are seen: where both joints happen to cancel in them, nothing tells.
    if mean > 0.6:
        assert abs(mean - 1.0) <= 1.1 * cut + 0.02


def test_joints_that_do_not_act_on_each_other_are_not_charged_for_a_beat_they_do_not_make():
    def force(t):
        return np.sin(2 * np.pi * 1.4 * t) ** 2 + np.sin(2 * np.pi * 1.3 * t) ** 2

    _, cut = measured(trial(force, {"tail": 1.4, "fin": 1.3}, CyclesOf(cycles_of="tail")))
    assert cut < 0.25  # the sum of both lines is 1.0


@settings(max_examples=40)
@given(st.lists(HZ, min_size=1, max_size=3, unique=True), st.floats(6.0, 60.0))
def test_a_window_of_beats_is_whole_for_every_joint_or_none_is_better(frequencies_hz, end_s):
    start_s, stop_s = averaging_window(0.0, end_s, frequencies_hz, "beats", None)
    turns = np.array(frequencies_hz) * (stop_s - start_s)
    lengths = np.linspace(1.0 / min(frequencies_hz), end_s, 5000)
    others = np.abs(lengths[:, None] * frequencies_hz - np.round(lengths[:, None] * frequencies_hz)).max(
        axis=1
    )
    assert np.abs(turns - np.round(turns)).max() <= RESIDUAL + 1e-9 or others.min() > 0.9 * RESIDUAL
    assert stop_s == end_s
    assert start_s >= 0.0


def test_beats_of_a_common_cycle_are_whole_common_cycles():
    start_s, stop_s = averaging_window(0.3, 6.5, [1.0, 1.5], "beats", None)
    assert stop_s - start_s == pytest.approx(6.0)
    assert left_over(1.5, stop_s - start_s) == pytest.approx(0.0, abs=1e-12)


def test_where_nothing_moves_everything_counts_and_nothing_is_cut():
    signals = trial(lambda t: 0.2 + 0 * t, {}, "beats", counts_from_s=0.3)
    assert signals.window() == (0.3, 6.5)
    assert measured(signals) == (pytest.approx(0.2), 0.0)


def test_cycle_mean_takes_what_the_file_says_to_average_over():
    def force(t):
        return np.sin(2 * np.pi * 0.9 * t)

    signals = trial(force, {"tail": 0.9}, "beats")
    assert measured(signals, "cycle-mean")[0] == pytest.approx(0.0, abs=0.01)


def test_discarded_cycles_are_those_of_the_joint_or_of_the_slowest_one():
    frequencies = {"tail": 1.0, "fin": 0.5}
    tail = trial(np.sin, frequencies, CyclesOf(cycles_of="tail"), discard_cycles=2, end_s=6.0)
    beats = trial(np.sin, frequencies, "beats", discard_cycles=2, end_s=6.0)
    assert tail.window()[0] == pytest.approx(2.0)
    assert beats.window()[0] == pytest.approx(4.0)


def test_a_recording_without_a_whole_cycle_says_so():
    signals = trial(np.sin, {"tail": 0.1}, CyclesOf(cycles_of="tail"))
    with pytest.raises(ExperimentError, match="no whole cycle of tail"):
        signals.window()


def test_without_an_average_nothing_is_said_of_cut_cycles():
    assert measured(trial(np.sin, {"tail": 1.0}, None))[1] == 0.0
