"""The small rules on their own: outliers, order, repeats, clocks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.experiment import Outliers, RepeatRule
from labrun.runner import RealClock, SimulatedClock
from labrun.runner.measurement import Measurement, block_order, find_outliers, modified_z, needs_another
from labrun.store import TrialOutcome


def measured(*values, status="done"):
    """Return a measurement with one trial a value."""
    outcomes = [
        TrialOutcome(i, {"a": 1}, i, status=status, objectives={"thrust": float(value)})
        for i, value in enumerate(values)
    ]
    return Measurement({"a": 1}, "measure", tuple(outcomes))


@given(st.lists(st.floats(-10, 10), min_size=3, max_size=20), st.floats(-100, 100), st.floats(0.1, 50))
def test_the_outlier_score_does_not_depend_on_offset_or_unit(values, offset, scale):
    values = np.round(np.array(values), 3)
    assert np.allclose(modified_z(scale * values + offset), modified_z(values), atol=1e-6, rtol=1e-6)


def test_for_normal_data_the_score_is_the_distance_in_standard_deviations():
    values = np.random.default_rng(0).normal(3.0, 2.0, 20_000)
    assert np.std(modified_z(values)) == pytest.approx(1.0, abs=0.02)


def test_one_value_off_among_equals_is_still_found():
    outliers = find_outliers(measured(*[1.0] * 9, 5.0), Outliers(rule="mad", threshold=3.5), "thrust")
    assert list(outliers) == [9]


def test_equal_values_hold_no_outlier():
    assert find_outliers(measured(2.0, 2.0, 2.0), Outliers(rule="mad"), "thrust") == {}


def test_below_the_declared_minimum_nothing_is_judged():
    assert find_outliers(measured(1.0, 1.0, 1.1, 90.0), Outliers(rule="mad", minimum=5), "thrust") == {}


@given(st.integers(1, 60), st.integers(0, 2**31), st.integers(0, 10_000))
def test_a_block_holds_each_condition_once_and_is_the_same_for_the_same_seed(count, seed, index):
    order = block_order(range(count), "shuffled", seed=seed, trial_index=index)
    assert sorted(order) == list(range(count))
    assert order == block_order(range(count), "shuffled", seed=seed, trial_index=index)


@given(st.integers(1, 5), st.integers(0, 5), st.integers(0, 30))
def test_no_rule_asks_for_trials_without_end(least, more, failed):
    rule = RepeatRule(min=least, max=least + more, standard_error={"thrust": 1e-12})
    if failed > rule.max:
        assert not needs_another(measured(*range(failed), status="failed"), rule)
    assert not needs_another(measured(*range(rule.max)), rule)
    assert needs_another(measured(*range(least - 1)), rule)


def test_a_single_trial_has_no_finite_standard_error():
    assert measured(1.0).standard_error("thrust") == np.inf


@given(st.lists(st.floats(-1, 5), max_size=10))
def test_a_simulated_clock_moves_by_what_is_waited_for_and_never_back(waits):
    clock = SimulatedClock(start_s=7.0)
    for wait in waits:
        clock.sleep(wait)
    assert clock.now() == pytest.approx(7.0 + sum(wait for wait in waits if wait > 0))


def test_the_real_clock_waits_at_least_as_long_as_asked():
    clock = RealClock()
    start_s = clock.now()
    clock.sleep(0.01)
    clock.sleep(-1.0)
    assert clock.now() - start_s >= 0.01
