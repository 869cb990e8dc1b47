"""Lives after Weibull, with specimens that outlive the test."""

import numpy as np
import pytest
from labrun_plugins.rigs.hinge_life.lives import Life, _outlived, falls_per_decade, fit_weibull, intervals
from scipy.stats import CensoredData, weibull_min


def test_the_fit_is_that_of_scipy_with_and_without_survivors():
    rng = np.random.default_rng(1)
    lives = 2500 * rng.weibull(3.0, 40)
    for limit in (np.inf, 2600.0):
        cycles, failed = np.minimum(lives, limit), lives < limit
        weibull = fit_weibull(cycles, failed)
        data = CensoredData.right_censored(cycles, ~failed)
        shape, _, scale = weibull_min.fit(data, floc=0)
        assert weibull.shape == pytest.approx(shape, rel=1e-3)
        assert weibull.scale == pytest.approx(scale, rel=1e-3)


@pytest.mark.parametrize("limit", [pytest.param(np.inf, marks=pytest.mark.slow), 3200.0])
def test_intervals_hold_the_median_and_the_shape_as_often_as_they_say(limit):
    rng = np.random.default_rng(2)
    draws = np.random.default_rng(3)
    held = np.zeros(2)
    median = 2500.0
    count = 0
    for _ in range(200):
        lives = median * (rng.exponential(size=5) / np.log(2)) ** (1 / 3)
        failed = lives < limit
        if np.count_nonzero(failed) < 2:
            continue
        count += 1
        weibull = fit_weibull(np.minimum(lives, limit), failed)
        (low, high), (thin, wide) = intervals(weibull, 5, int(np.count_nonzero(failed)), draws)
        held += [low < median < high, thin < 3.0 < wide]
    assert np.all(held / count > 0.90)
    assert held[0] / count < 0.995


def test_more_cycles_than_anything_lived_are_never_a_number():
    life = Life("sandwich", np.full(5, 50_000.0), np.zeros(5, dtype=bool))
    message = _outlived(life)
    assert message.startswith("> 50,000 cycles: all 5 outlived the test")
    assert "97 % sure" in message


def test_a_torque_that_falls_by_a_share_per_decade_is_told_by_it():
    course = 0.14 * (1 - 0.05 * np.log10(np.arange(1, 3001)))
    course[-1] = 0.003
    life = Life("polyester", np.array([3000.0]), np.array([True]), (course,))
    assert falls_per_decade(life) == pytest.approx(0.05, rel=1e-3)
