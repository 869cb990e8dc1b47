"""Whether the order on one bench holds on another."""

import itertools

import numpy as np
import pytest
from scipy import stats

from labrun.search import agreement, pooled_intervals, t_interval

RNG = np.random.default_rng(1)


def trials(means, sd=0.0, count=3, seed=1):
    rng = np.random.default_rng(seed)
    return [mean + sd * rng.standard_normal(count) for mean in means]


def test_the_same_order_of_eight_has_the_least_p_that_eight_can_have():
    result = agreement(trials(range(8)), trials(np.arange(8) ** 2.0), RNG)
    assert result.tau == pytest.approx(1.0)
    assert result.spearman == pytest.approx(1.0)
    assert result.exact
    assert result.tau_p == pytest.approx(2 / 40320)
    assert result.carries_over
    assert result.ties == 0


@pytest.mark.parametrize("seed", range(4))
def test_tau_rho_and_the_exact_p_are_scipys_own(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal(6), rng.standard_normal(6)
    result = agreement(trials(x), trials(y), RNG)
    kendall = stats.kendalltau(x, y, method="exact")
    assert result.tau == pytest.approx(kendall.statistic)
    assert result.tau_p == pytest.approx(kendall.pvalue)
    rho = stats.spearmanr(x, y).statistic
    assert result.spearman == pytest.approx(rho)
    every = [stats.spearmanr(x, np.array(order)).statistic for order in itertools.permutations(y)]
    one_side = min(np.mean(np.array(every) >= rho - 1e-12), np.mean(np.array(every) <= rho + 1e-12))
    assert result.spearman_p == pytest.approx(min(1.0, 2 * one_side))


def test_ties_are_counted_and_lower_tau_as_tau_b_says():
    x, y = np.array([1.0, 1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.0, 3.0, 4.0, 4.0])
    result = agreement(trials(x), trials(y), RNG)
    assert result.ties == 2
    assert result.tau == pytest.approx(stats.kendalltau(x, y).statistic)


def test_noise_on_one_side_does_not_carry_over():
    result = agreement(trials([3, 1, 2, 5, 4, 7, 6, 8]), trials([5, 2, 8, 1, 3, 4, 7, 6], sd=2.0), RNG)
    assert not result.carries_over
    assert result.tau_ci95[0] < result.tau < result.tau_ci95[1]


@pytest.mark.parametrize("entry", [[1, 2], [1, 1, 1, 1], []])
def test_too_few_or_all_alike_have_no_order(entry):
    assert agreement(trials(entry), trials(range(len(entry))), RNG) is None


def test_candidates_of_one_water_are_judged_by_one_scatter_and_a_lucky_one_is_not_sure():
    lucky = np.array([10.0, 10.0, 10.1])
    samples = [lucky, np.array([9.0, 11.0, 13.0]), np.array([8.0, 12.0, 10.0]), np.array([7.0])]
    intervals = pooled_intervals(samples, [0.0, 0.0, 0.5, 0.0])
    freedom, variance = 6, sum(((sample - sample.mean()) ** 2).sum() for sample in samples) / 6
    half = stats.t.ppf(0.975, freedom) * np.sqrt(variance / 3)
    assert intervals[0] == pytest.approx((lucky.mean() - half, lucky.mean() + half))
    assert intervals[2] == pytest.approx((10.0 - half - 0.5, 10.0 + half + 0.5))
    assert intervals[3] is None


def test_pooled_intervals_hold_the_true_mean_as_often_as_they_say():
    rng = np.random.default_rng(3)
    held = [
        low <= 5.0 <= high
        for _ in range(200)
        for low, high in pooled_intervals(list(5.0 + rng.normal(size=(8, 3))), [0.0] * 8)
    ]
    assert 0.92 < np.mean(held) < 0.98


def test_a_candidate_that_clearly_scatters_more_keeps_its_own_interval():
    rng = np.random.default_rng(4)
    samples = [*(10.0 + rng.normal(size=(3, 20))), 10.0 + 30.0 * rng.normal(size=20)]
    for values, interval in zip(samples, pooled_intervals(samples, [0.0] * 4), strict=True):
        assert interval == pytest.approx(t_interval(values))
