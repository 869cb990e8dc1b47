"""Scatter within and between mountings, and intervals that know of both."""

import numpy as np
import pytest

from labrun.search import mean_error, scatter, t_interval


def mounted(rng, *, mountings, repeats, between, within):
    """Return values and their mountings, about a true mean of 5."""
    offsets = between * rng.standard_normal(mountings)
    values = 5.0 + np.repeat(offsets, repeats) + within * rng.standard_normal(mountings * repeats)
    return values, [1 + index // repeats for index in range(mountings * repeats)]


def test_the_error_of_a_balanced_mean_is_that_of_the_mountings_means():
    values, mountings = mounted(np.random.default_rng(1), mountings=4, repeats=3, between=1.0, within=0.1)
    means = values.reshape(4, 3).mean(axis=1)
    assert mean_error(values, mountings) == (pytest.approx(means.std(ddof=1) / 2), 3)


def test_without_mountings_it_is_that_of_independent_values():
    values = np.array([1.0, 2.0, 4.0])
    expected = (pytest.approx(values.std(ddof=1) / np.sqrt(3)), 2)
    for mountings in ((), [None] * 3, [1, 2, 3]):
        assert mean_error(values, mountings) == expected
    assert mean_error(values[:1]) is None


def test_intervals_over_mountings_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(7)
    held = naive = 0
    for _ in range(400):
        values, mountings = mounted(rng, mountings=5, repeats=4, between=0.5, within=0.2)
        held += np.prod(np.subtract(t_interval(values, mountings), 5.0)) <= 0
        naive += np.prod(np.subtract(t_interval(values), 5.0)) <= 0
    assert held / 400 == pytest.approx(0.95, abs=0.03)
    assert naive / 400 < 0.8  # values of one mounting are not independent


def test_the_scatter_of_either_kind_is_found_with_unequal_numbers():
    rng = np.random.default_rng(3)
    samples = []
    for _ in range(300):
        values, mountings = mounted(rng, mountings=4, repeats=5, between=0.3, within=0.1)
        keep = rng.random(len(values)) < 0.8
        samples.append((values[keep], [m for m, kept in zip(mountings, keep, strict=True) if kept]))
    result = scatter(samples)
    assert result.within == pytest.approx(0.1, rel=0.05)
    assert result.between == pytest.approx(0.3, rel=0.06)


def test_mountings_that_differ_no_more_than_their_trials_add_nothing():
    assert scatter([(np.array([1.0, 3.0, 1.0, 3.0]), [1, 1, 2, 2])]).between == 0.0
    assert scatter([(np.array([1.0, 3.0]), [None, None])]).between is None
