"""A prediction beside data: sizes of errors, and their order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.fit import Comparison, Pair, compared


def pair(measured, predicted, *, channel="thrust", **condition):
    measured = np.atleast_1d(np.asarray(measured, dtype=float))
    predicted = np.broadcast_to(np.asarray(predicted, dtype=float), measured.shape)
    time_s = 0.1 * np.arange(len(measured))
    return Pair(str(condition), condition, channel, "N", time_s, measured, predicted)


sizes = st.floats(0.1, 10.0)


@given(st.lists(st.tuples(sizes, sizes), min_size=1, max_size=8))
def test_a_table_is_off_by_the_difference_over_what_was_measured_the_worst_first(rows):
    points = compared([pair(first, other, row=float(index)) for index, (first, other) in enumerate(rows)])
    largest = max(size for size, _ in rows)
    expected = sorted((abs(first - other) / max(first, largest / 20) for first, other in rows), reverse=True)
    assert [point.relative for point in points] == pytest.approx(expected)


def test_next_to_zero_an_error_is_told_in_shares_of_the_largest():
    points = compared([pair(2.0, 2.0, angle=0.0), pair(0.0, 0.01, angle=90.0)])
    assert points[0].condition == {"angle": 90.0}
    assert points[0].relative == pytest.approx(0.1)  # 0.01 of a twentieth of 2


def test_where_nothing_but_zero_was_measured_no_share_is_made_up():
    assert compared([pair(0.0, 0.1)])[0].relative == np.inf
    assert compared([pair(0.0, 0.0)])[0].relative == 0.0


def test_repeats_of_a_condition_are_one_point_and_channels_are_weighed_by_themselves():
    pairs = [pair(1.0, 1.1, a=1.0), pair(1.2, 1.1, a=1.0), pair(1e-3, 2e-3, a=1.0, channel="side")]
    points = compared(pairs)
    assert [(point.channel, point.trials) for point in points] == [("side", 1), ("thrust", 2)]
    assert points[0].relative == pytest.approx(1.0)
    assert points[1].measured == pytest.approx(1.1)
    assert points[1].rmse == pytest.approx(0.1)


def test_a_signal_says_at_which_moment_it_is_off_the_most():
    measured = np.sin(np.arange(20.0))
    predicted = measured.copy()
    predicted[7] += 0.5
    point = compared([pair(measured, predicted)])[0]
    assert point.at_s == pytest.approx(0.7)
    assert point.predicted - point.measured == pytest.approx(0.5)
    assert point.rmse == pytest.approx(0.5 / np.sqrt(20))


@pytest.mark.parametrize(("tolerance", "within"), [(None, True), (0.2, True), (0.05, False)])
def test_a_comparison_is_within_its_tolerance_if_its_worst_point_is(tolerance, within):
    pairs = (pair(1.0, 1.1, a=1.0), pair(1.0, 1.0, a=2.0))
    assert Comparison("data", "theory", pairs, compared(pairs), 2, tolerance).within is within
