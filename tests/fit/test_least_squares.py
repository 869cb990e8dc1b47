"""Baskets of regressors: conditioning, collinearity, coefficients, errors of baskets that cannot be made."""

import numpy as np
import pytest

from labrun.app.fit import fit
from labrun.app.run import run as execute
from labrun.errors import RequestError
from labrun.experiment import load_named
from labrun.fit.regression.method import (
    BASKETS,
    collinear,
    condition,
    regress,
    solve,
    term_values,
)

STEP_S = 0.05


def inputs():
    """Eq. (5.3) as printed."""
    time_s = np.arange(0.0, 500.0, STEP_S)
    b = 20 * np.sin(2 * np.pi * 0.002 * time_s)
    return {"a": 20 + np.abs((40 - b) * np.sin(2 * np.pi * 0.004 * time_s)), "b": b}


def matrix(terms):
    return np.column_stack([term_values(term, inputs(), STEP_S) for term in terms])


@pytest.mark.parametrize(
    ("basket", "published"),
    [("a,b", 12), ("+a',b'", 7.5e4), ("+a^2,b^2", 1.1e5), ("+a^3,b^3", 3.6e9), ("+a^4,b^4", 1.6e14)],
)
def test_conditioning_on_the_printed_inputs_is_as_derived_from_the_source(basket, published):
    values = matrix(BASKETS[basket])
    assert condition(values) == pytest.approx(published, rel=0.08)
    if published < 1e10:
        assert condition(values) == pytest.approx(np.linalg.cond(values.T @ values), rel=1e-3)


def test_the_second_derivative_of_a_sine_is_told_as_collinear_with_it():
    time_s = np.arange(0.0, 500.0, STEP_S)
    b = np.sin(2 * np.pi * 0.002 * time_s)
    values = np.column_stack([b, -((2 * np.pi * 0.002) ** 2) * b, np.cos(time_s)])
    assert collinear(values, ["b", "b''", "c"]) == (2, ["b and b''"])


def test_exact_coefficients_come_back_from_a_badly_scaled_basket():
    values = matrix(BASKETS["+a^3,b^3"])
    true = np.array([1e-2, -3e-3, 1e-4, 2e-5, -1e-6, 5e-7])
    assert solve(values, values @ true) == pytest.approx(true, rel=1e-6)


def test_errors_shared_by_a_block_widen_the_interval_beyond_that_of_single_samples():
    rng = np.random.default_rng(1)
    values = matrix(["a", "b"])
    groups = np.arange(len(values)) // 500
    noise = 0.05 * rng.standard_normal(groups[-1] + 1)[groups]
    regression = regress(values, values @ np.array([0.009, -0.004]) + noise, groups, rng)
    naive = 1.96 * 0.05 * np.sqrt(np.diag(np.linalg.inv(values.T @ values)))
    assert np.all(regression.high - regression.low > 5 * naive)
    assert np.all((regression.low < [0.009, -0.004]) & (regression.high > [0.009, -0.004]))


@pytest.mark.parametrize("term", ["c", "a^", "sin(a)"])
def test_a_term_that_cannot_be_made_is_refused(term):
    with pytest.raises(RequestError):
        term_values(term, inputs(), STEP_S)


def test_a_dry_run_has_the_order_of_merit_of_table_5_3(tmp_path):
    loaded = load_named("fin-modulation", tmp_path)
    run = execute(loaded, results=tmp_path, dry_run=True, seed=1, draw=False).run
    result = fit(run, results=tmp_path)
    record = result.record()
    mae = record["mae"]["FF"]
    assert record["taken"] == "a,b"
    assert mae["+a^3,b^3"] < mae["+a^2,b^2"] < mae["a,b"]
    assert mae["+a',b'"] > 0.97 * mae["a,b"]
    assert mae["+a'',b''"] > 0.97 * mae["a,b"]
    assert result.figure.is_file()


SWIM = {
    "inputs": {"a": "gait.a"},
    "outputs": {"FF": {"channel": "wrench.torque_y", "scale": -1, "divide_by_m": 0.4, "average": "cycle"}},
    "baskets": {"a": ["a"], "a,a^2,a^3": ["a", "a^2", "a^3"]},
}


@pytest.fixture(scope="module")
def modulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("modulated")
    return execute("fin-amplitude", dry_run=True, seed=1, results=folder).run


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        (0.0096, "agrees with the stated 0.0096"),
        (0.00912, "does not hold the stated 0.00912: it is off by +5"),
    ],
)
def test_a_stated_coefficient_is_held_against_the_interval(modulated, stated, expected):
    result = fit(modulated, settings={"stated": {"FF": {"a": stated}}})
    assert any(expected in sentence for sentence in result.findings)


def test_a_basket_with_too_few_trials_for_its_aicc_says_so(modulated):
    result = fit(modulated)
    (table,) = result.tables
    index = table.header.index("AICc")
    assert [row[index] for row in table.rows][-1] == "-"
    assert any("AICc of {a,a^2,a^3} needs more trials" in sentence for sentence in result.findings)


@pytest.mark.parametrize(("output", "term"), [("SF", "a"), ("FF", "b")])
def test_a_stated_coefficient_of_what_is_not_fitted_is_refused(output, term):
    from labrun.fit import make_method

    with pytest.raises(RequestError, match="stated"):
        make_method("least-squares", {**SWIM, "stated": {output: {term: 1.0}}})
