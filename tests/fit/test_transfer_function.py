from dataclasses import replace

import numpy as np
import pytest
from answering import answer
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from labrun.app.fit import fit as run_fit
from labrun.fit.transfer import TransferFunction
from labrun.fit.transfer.fitting import ResponseTrial, Shape, compare_orders, fit_transfer, unconverged
from labrun.fit.transfer.method import (
    TransferFunctionFit,
    TransferFunctionSettings,
    response_figure,
    warnings_of,
)

TIME_S = np.arange(0.0, 10.0, 0.02)


def trials_of(transfer, rng, count=4, noise=0.02):
    trials = []
    for number in range(count):
        given_ = np.cumsum(rng.standard_normal(len(TIME_S))) * 0.2
        clean = answer(transfer, TIME_S, given_)
        measured = clean + noise * rng.standard_normal(len(TIME_S))
        trials.append(ResponseTrial(f"trial {number}", TIME_S, given_, measured, TIME_S >= 0))
    return trials


@given(speed=st.floats(1, 20), damping=st.floats(0.05, 2), zero=st.sampled_from([-0.5, 0.0, 0.5]))
@settings(max_examples=20, deadline=None)
def test_a_second_order_system_answers_as_scipy_says(speed, damping, zero):
    transfer = TransferFunction((zero, 2.0), (1 / speed**2, 2 * damping / speed, 1.0))
    values = np.sin(3 * TIME_S) + 0.3 * TIME_S
    _, expected, _ = lsim((transfer.numerator, transfer.denominator), values, TIME_S)
    assert answer(transfer, TIME_S, values) == pytest.approx(expected, abs=1e-6)


@given(speed=st.floats(1, 10), damping=st.floats(0.1, 1.0), seed=st.integers(0, 9))
@settings(max_examples=3, deadline=None)
def test_poles_and_dead_time_come_back(speed, damping, seed):
    truth = TransferFunction((2.0,), (1 / speed**2, 2 * damping / speed, 1.0), 0.11)
    rng = np.random.default_rng(seed)
    fit = fit_transfer(
        trials_of(truth, rng, count=2, noise=1e-4), Shape(2, 0, initial="free"), rng=rng, starts=1
    )
    assert fit.transfer.gain == pytest.approx(2.0, rel=0.02)
    omega = np.geomspace(0.3, 10, 20)
    assert fit.transfer.frequency_response(omega) == pytest.approx(truth.frequency_response(omega), rel=0.05)


@pytest.mark.slow
def test_the_interval_of_the_gain_holds_the_truth_about_as_often_as_it_says():
    truth = TransferFunction((1.5,), (0.04, 0.2, 1.0))
    held = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        fit = fit_transfer(trials_of(truth, rng), Shape(2, 0, dead_time=False), rng=rng, starts=1)
        low, high = fit.estimate(lambda transfer: transfer.gain, "").ci95
        held += low <= 1.5 <= high
    assert held >= 8


def test_a_pole_that_a_zero_cancels_is_warned_of():
    rng = np.random.default_rng(1)
    fit = fit_transfer(
        trials_of(TransferFunction((1.0,), (0.3, 1.0)), rng, count=2), Shape(2, 1, dead_time=False), rng=rng
    )
    assert any(
        "nearly cancel" in warning or "do not determine" in warning for warning in warnings_of(fit, "y")
    )


def test_what_is_simulated_leaves_what_the_search_minimised_with_poles_far_apart():
    # the free answers of such poles differ by rounding only, and late samples see next to nothing of them
    rng = np.random.default_rng(3)
    trials = [
        replace(trial, used=TIME_S >= 3.0)
        for trial in trials_of(TransferFunction.first_order(-0.8, 0.3), rng, count=2, noise=0.1)
    ]
    fit = fit_transfer(trials, Shape(2, 0, dead_time=False, initial="free"), rng=rng)
    assert sum(float(part @ part) for part in fit.residuals()) == pytest.approx(fit.point.squares, rel=1e-3)
    assert max(np.max(np.abs(own)) for own in fit.point.own) < 1e6


def test_the_picture_shows_an_answer_from_where_it_is_fitted_on():
    rng = np.random.default_rng(0)
    trials = [
        replace(trial, used=TIME_S >= 3.0)
        for trial in trials_of(TransferFunction((1.5,), (0.04, 0.2, 1.0)), rng)
    ]
    fit = fit_transfer(trials, Shape(2, 0, dead_time=False, initial="free"), rng=rng, starts=1)
    overlay = response_figure({"force": fit}, "a fit").rows[0][0].panels[0]
    fitted = [curve for curve in overlay.curves if curve.role == "fitted"]
    assert len(fitted) == len(trials)
    assert all(curve.x[0] == pytest.approx(3.0) for curve in fitted)


def test_an_order_that_left_more_than_one_it_contains_did_not_converge():
    left = {Shape(1, 0): 2.0, Shape(2, 0): 2.1, Shape(2, 1): 1.0, Shape(3, 0): 1.5, Shape(1, 1): 1.00001}
    assert unconverged(left) == {Shape(2, 0)}


def test_in_the_comparison_of_orders_a_fit_that_did_not_converge_is_marked_and_not_spoken_for():
    rng = np.random.default_rng(2)
    fit = fit_transfer(
        trials_of(TransferFunction((1.5,), (0.04, 0.2, 1.0)), rng, count=2),
        Shape(2, 0, dead_time=False),
        rng=rng,
    )
    table, messages = compare_orders(fit, "y")
    assert not any("converge" in cell for row in table.rows for cell in row)
    assert not any("converge" in message for message in messages)
    # the same fit, said to have left far more: as if its search had stopped on its way
    stuck = replace(fit, point=replace(fit.point, squares=1e4 * fit.point.squares))
    table, messages = compare_orders(stuck, "y")
    own = next(row for row in table.rows if "this one" in row[0])
    assert own[-1] == "did not converge"
    assert any("y: this order left more than a smaller one" in message for message in messages)


def test_more_zeros_than_poles_are_refused():
    with pytest.raises(ValueError, match="zeros = 3"):
        TransferFunctionSettings(poles=2, zeros=3)
    assert TransferFunctionFit.Settings is TransferFunctionSettings


def test_the_silverbox_is_an_oscillator_of_about_70_hz(recordings, tmp_path):
    settings_ = {"poles": 2, "zeros": 0, "compare": False, "input": "drive", "output": "response"}
    silverbox = recordings / "silverbox"
    result = run_fit(silverbox, method="transfer-function", settings=settings_, results=tmp_path, starts=1)
    pole = result.transfer.poles[0]
    assert abs(pole) / (2 * np.pi) == pytest.approx(69.5, abs=1)
    assert len(list(tmp_path.rglob("transfer-function.toml"))) == 1
