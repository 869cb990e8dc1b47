"""Intervals from resampling whole trials cover the truth as often as they say."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from labrun.fit.uncertainty import resample_trials

FloatArray = NDArray[np.float64]


def linear_trials(
    rng: np.random.Generator, trials: int, size: int, unequal: float, scatter: float
) -> tuple[FloatArray, FloatArray]:
    """Return J'J and J'y of trials whose true parameters are zero, with white noise and trial-to-trial scatter."""
    information, pulls = [], []
    for _ in range(trials):
        matrix = rng.normal(size=(60, size)) * (1 + unequal * rng.exponential(size=size))
        residual = rng.normal(size=60) + matrix @ (scatter * rng.normal(size=size))
        information.append(matrix.T @ matrix)
        pulls.append(matrix.T @ residual)
    return np.array(information), np.array(pulls)


@pytest.mark.parametrize(
    ("trials", "size", "unequal", "scatter"),
    [(3, 2, 0.0, 0.3), (5, 3, 1.0, 0.3), (5, 3, 1.0, 0.0), (12, 3, 1.0, 0.3)],
)
def test_intervals_cover_the_truth_about_95_times_in_100(
    trials: int, size: int, unequal: float, scatter: float
) -> None:
    rng = np.random.default_rng(trials)
    covered = []
    for _ in range(300):
        information, pulls = linear_trials(rng, trials, size, unequal, scatter)
        estimate = np.linalg.solve(information.sum(axis=0), pulls.sum(axis=0))
        score = pulls - information @ estimate
        resampled = resample_trials(information, score, rng=rng, resamples=400)
        covered.append((estimate + resampled.low <= 0.0) & (estimate + resampled.high >= 0.0))
    assert 0.90 <= float(np.mean(covered)) <= 0.985


def test_many_equal_trials_give_the_standard_error_of_the_mean() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=200)
    score = (values - values.mean())[:, None]
    trials = resample_trials(np.ones((200, 1, 1)), score, rng=rng, resamples=8000)
    expected = stats.t.ppf(0.975, 199) * values.std(ddof=1) / np.sqrt(200)
    assert trials.high[0] == pytest.approx(expected, rel=0.05)
    assert trials.low[0] == pytest.approx(-expected, rel=0.05)


def test_what_only_the_prior_knows_keeps_the_prior_width() -> None:
    rng = np.random.default_rng(2)
    information = np.zeros((6, 2, 2))
    information[:, 0, 0] = 1e4
    score = np.zeros((6, 2))
    trials = resample_trials(information, score, rng=rng, prior_sigma=np.array([np.inf, 0.1]), resamples=8000)
    student = stats.t.ppf(0.975, 5) / 1.96
    assert trials.high[1] == pytest.approx(1.96 * 0.1 * student, rel=0.05)
    assert trials.high[0] == pytest.approx(0.0, abs=1e-12)


def test_units_of_the_parameters_change_nothing_but_the_units() -> None:
    information, pulls = linear_trials(np.random.default_rng(3), 6, 2, 1.0, 0.3)
    score = pulls - information @ np.linalg.solve(information.sum(axis=0), pulls.sum(axis=0))
    units = np.array([1e-6, 1e5])
    plain = resample_trials(information, score, rng=np.random.default_rng(4))
    scaled = resample_trials(
        information * units[:, None] * units, score * units, rng=np.random.default_rng(4)
    )
    np.testing.assert_allclose(scaled.high * units, plain.high, rtol=1e-6)


def test_the_same_seed_gives_the_same_interval() -> None:
    information, pulls = linear_trials(np.random.default_rng(5), 6, 2, 1.0, 0.3)
    first, second = (resample_trials(information, pulls, rng=np.random.default_rng(6)) for _ in range(2))
    np.testing.assert_array_equal(first.draws, second.draws)
