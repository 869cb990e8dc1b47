"""The cycles that are shown large."""

import numpy as np

from labrun.report.figures.gap_traces import telling_window

TIME_S = np.arange(0.0, 10.0, 0.01)
SWING = np.sin(2 * np.pi * 3.0 * TIME_S + 0.3)


def test_of_many_cycles_the_few_are_shown_in_which_the_difference_is_greatest():
    shown = telling_window(TIME_S, SWING, np.exp(-(((TIME_S - 7.0) / 0.4) ** 2)) * SWING)
    length_s = (shown.stop - shown.start) * 0.01
    assert 0.9 < length_s < 1.2  # three cycles
    assert TIME_S[shown].mean() == np.clip(TIME_S[shown].mean(), 6.8, 7.2)


def test_a_few_cycles_are_shown_whole():
    assert telling_window(TIME_S, np.sin(2 * np.pi * 0.3 * TIME_S), SWING) == slice(0, len(TIME_S))


def test_what_does_not_swing_is_shown_whole():
    assert telling_window(TIME_S, np.ones_like(TIME_S), SWING) == slice(0, len(TIME_S))


def test_the_window_stays_inside_where_the_end_is_worst():
    shown = telling_window(TIME_S, SWING, TIME_S**4)
    assert shown.stop == len(TIME_S)
