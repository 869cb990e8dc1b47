"""Evidence: how data are divided into units, and what a unit's log error contains."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from labrun.fit import Dataset
from labrun.gap.averaging import averaged
from labrun.gap.evidence import Units, correlation_samples, error_of
from labrun.gap.noise import of_sensor

from .benches import CONDITIONS, FloatArray, nothing, pendulum, recorded


def data_of(conditions: int, repeats: int = 1) -> Dataset:
    return averaged(recorded(nothing, repeats=repeats, conditions=CONDITIONS[:conditions]), pendulum())


def residuals(data: Dataset, colour: float, seed: int = 0) -> list[FloatArray]:
    """Return noise of standard deviation 1 of every trial; `colour` is what one sample keeps of the one before."""
    rng = np.random.default_rng(seed)
    return [
        np.sqrt(1.0 - colour**2)
        * lfilter([1.0], [1.0, -colour], rng.standard_normal(trial.outputs.shape), axis=0)
        for trial in data.trials
    ]


@given(st.integers(2, 5), st.sampled_from([0.0, 0.8, 0.97, 0.995]), st.integers(0, 99))
def test_conditions_are_cut_into_blocks_that_are_longer_than_the_correlation_time(
    conditions: int, colour: float, seed: int
) -> None:
    data = data_of(conditions)
    residual = residuals(data, colour, seed)
    units = Units.of(data, residual)
    assert len(units.strata) == sum(units.blocks)
    for blocks, trial_residual in zip(units.blocks, residual, strict=True):
        assert blocks == 1 or len(trial_residual) / blocks >= correlation_samples(trial_residual)


def test_the_fewer_the_conditions_the_more_blocks_each_is_cut_into() -> None:
    blocks = [Units.of(data, residuals(data, 0.0)).blocks for data in map(data_of, (1, 2, 5))]
    assert min(blocks[0]) > max(blocks[1]) > max(blocks[2]) >= 1


def test_a_residual_that_is_slow_beside_its_trial_makes_hardly_more_units_than_there_are_conditions() -> None:
    data = data_of(3)
    slow = [np.sin(0.6 * np.pi * trial.time_s / trial.time_s[-1])[:, None] for trial in data.trials]
    assert max(Units.of(data, slow).blocks) <= 2


def test_one_condition_has_two_blocks_at_least_since_one_unit_decides_nothing() -> None:
    data = data_of(1)
    slow = [np.sin(0.6 * np.pi * trial.time_s / trial.time_s[-1])[:, None] for trial in data.trials]
    assert Units.of(data, slow).blocks == (2,)


@pytest.mark.parametrize("repeats", [1, 4])
def test_of_noise_alone_the_error_is_that_of_the_mean_of_the_repeats(repeats: int) -> None:
    data = data_of(3, repeats)
    mean = [residual / np.sqrt(repeats) for residual in residuals(data, 0.0)]
    noise = replace(of_sensor(data, mean), sd=np.array([1.0]))
    units = Units.of(data, mean)
    error = error_of(data, noise, units, mean)
    assert len(error.log) == sum(units.blocks)
    assert error.mean == pytest.approx(-np.log(repeats), abs=0.15)
    assert error.rms[0] == pytest.approx(1.0 / np.sqrt(repeats), rel=0.05)


@given(st.floats(0.1, 100.0))
def test_twice_the_error_counts_the_same_whichever_condition_has_most_of_it(factor: float) -> None:
    data = data_of(4)
    left = residuals(data, 0.0)
    noise, units = of_sensor(data, left), Units.of(data, left)
    before = error_of(data, noise, units, left).mean
    shares = []
    for size in (1.0, 50.0):
        sized = [size * left[0], *left[1:]]
        larger = [factor * sized[0], *sized[1:]]
        shares.append(error_of(data, noise, units, larger).mean - error_of(data, noise, units, sized).mean)
    assert shares[0] == pytest.approx(shares[1])
    everywhere = error_of(data, noise, units, [factor * residual for residual in left]).mean
    assert everywhere - before == pytest.approx(2.0 * np.log(factor))


def test_a_deviation_that_all_trials_share_counts_as_error() -> None:
    data = data_of(3)
    left = residuals(data, 0.0)
    noise, units = of_sensor(data, left), Units.of(data, left)
    assert error_of(data, noise, units, left, [2.0] * 3).mean > error_of(data, noise, units, left).mean


def test_an_exact_prediction_has_a_finite_log_error() -> None:
    data = data_of(3)
    left = residuals(data, 0.0)
    noise, units = of_sensor(data, left), Units.of(data, left)
    assert np.all(np.isfinite(error_of(data, noise, units, [0.0 * residual for residual in left]).log))
