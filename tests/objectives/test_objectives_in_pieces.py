"""A trial too long for memory is judged piece by piece, with the same numbers as if it were whole."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.devices import Trajectory
from labrun.errors import ExperimentError
from labrun.objectives import TrialSignals
from labrun.objectives.channel import Amplitude, CycleMean, Direction, Mean, MeanAbsolute, Peak, Rms
from labrun.signals import Signal

EVERY = [
    (Mean, {}),
    (CycleMean, {}),
    (Rms, {"scale": -2.0}),
    (Peak, {}),
    (Amplitude, {}),
    (MeanAbsolute, {}),
    (MeanAbsolute, {"from_s": 0.4}),
    (MeanAbsolute, {"from_s": 0.4, "to_s": 1.9}),
    (Direction, {"side_channel": "w.y"}),
]


class Cut(Mapping):
    """Signals that are handed out in pieces cut at the given places, and never whole."""

    def __init__(self, signals, cuts):
        self._signals, self._cuts = signals, cuts

    def pieces(self, channel):
        signal = self._signals[channel]
        edges = [0, *sorted(self._cuts), len(signal.time_s)]
        for first, end in pairwise(edges):
            yield Signal(signal.time_s[first:end], signal.values[first:end], signal.unit)

    def __contains__(self, name):
        return name in self._signals

    def __getitem__(self, name):
        raise AssertionError("a long trial was asked for whole")

    def __iter__(self):
        return iter(self._signals)

    def __len__(self):
        return len(self._signals)


def trial(signals, period_s):
    command = Trajectory(("tail",), np.array([0.0, 2.5]), np.zeros((2, 1)))
    return TrialSignals(signals, command, 0.0, 2.5, period_s, 1 if period_s else 0)


def channels(seed, count):
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.uniform(-0.2, 2.7, count))
    return {name: Signal(time_s, rng.normal(0.3, 1.0, count), "N") for name in ("w.x", "w.y")}


@pytest.mark.parametrize(("kind", "keys"), EVERY)
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    period_s=st.sampled_from([None, 0.5]),
    cuts=st.lists(st.integers(0, 300), max_size=8),
)
def test_pieces_give_the_number_of_the_whole(kind, keys, seed, period_s, cuts):
    if kind is CycleMean:
        period_s = 0.5
    signals = channels(seed, 300)
    objective = kind("w.x", keys)
    whole = objective(trial(signals, period_s))
    assert objective(trial(Cut(signals, cuts), period_s)) == pytest.approx(whole, rel=1e-12, abs=1e-13)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), cuts=st.lists(st.integers(0, 40), max_size=8), lost=st.integers(0, 39))
def test_the_counting_part_is_the_same_sample_for_sample(seed, cuts, lost):
    signals = channels(seed, 40)
    time_s, values = signals["w.x"].time_s, signals["w.x"].values
    if not 0.5 < time_s[lost] < 2.5:
        values[lost] = np.nan  # outside the window nobody asks for it
    counting = trial(Cut(signals, cuts), 0.5).counting("w.x")
    finite = np.isfinite(values)
    inner = (time_s > 0.5) & (time_s < 2.5)
    ends = np.interp([0.5, 2.5], time_s[finite], values[finite])
    np.testing.assert_array_equal(counting.time_s, [0.5, *time_s[inner], 2.5])
    np.testing.assert_array_equal(counting.values, [ends[0], *values[inner], ends[1]])


@pytest.mark.parametrize("cuts", [[], [5, 20], [11]])
def test_a_value_that_is_no_number_is_refused_wherever_the_pieces_end(cuts):
    signals = channels(3, 40)
    signals["w.x"].values[20] = np.nan
    with pytest.raises(ExperimentError, match="not numbers"):
        Mean("w.x", {})(trial(Cut(signals, cuts), None))


def test_a_recording_outside_the_window_is_refused_in_pieces_too():
    time_s = np.linspace(3.0, 4.0, 50)
    signals = Cut({"w.x": Signal(time_s, time_s, "N")}, [10, 30])
    with pytest.raises(ExperimentError, match="fewer than 2 samples"):
        Mean("w.x", {})(trial(signals, None))
