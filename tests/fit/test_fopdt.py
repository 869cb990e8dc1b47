import control
import numpy as np
import pytest
import tomli_w
from answering import answer
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import FitError, RequestError
from labrun.fit.signals import SignalSet, trailing_mean
from labrun.fit.transfer import TransferFunction
from labrun.fit.transfer.fitting import ResponseTrial, Shape, fit_transfer
from labrun.fit.transfer.method import summarise, warnings_of

TIME_S = np.arange(0.0, 12.0, 0.02)
STEP = np.where(TIME_S < 2.0, 0.0, 40.0)


def trials_of(transfer, rng, *, count=6, noise=0.02, averaged=1):
    trials = []
    for number in range(count):
        clean = answer(transfer, TIME_S, STEP, hold="constant")
        if averaged > 1:
            clean = trailing_mean(clean, averaged)
        measured = clean + 0.01 * rng.standard_normal() + noise * rng.standard_normal(len(TIME_S))
        used = np.ones(len(TIME_S), dtype=bool)
        trials.append(ResponseTrial(f"trial {number}", TIME_S, STEP, measured, used, averaged, "constant"))
    return trials


@given(
    gain=st.floats(0.1, 10),
    lag_s=st.floats(0.05, 3),
    dead_s=st.floats(0, 2),
)
@settings(max_examples=15, deadline=None)
def test_a_step_is_answered_by_the_closed_form_of_a_lag_and_a_dead_time(gain, lag_s, dead_s):
    transfer = TransferFunction.first_order(gain, lag_s, dead_s)
    after = TIME_S - dead_s
    expected = np.where(after >= 0, gain * (1 - np.exp(-np.maximum(after, 0) / lag_s)), 0)
    assert transfer.step_response(TIME_S) == pytest.approx(expected, abs=1e-9 * gain)
    # the first sample of a held input is the step
    simulated = answer(transfer, TIME_S, np.ones(len(TIME_S)), hold="constant")
    assert simulated == pytest.approx(expected, abs=1e-9 * gain)


@given(dead_s=st.floats(0, 1), seed=st.integers(0, 99))
@settings(max_examples=10, deadline=None)
def test_any_input_is_answered_as_by_python_control(dead_s, seed):
    values = np.cumsum(np.random.default_rng(seed).standard_normal(200))
    time_s = np.arange(200) * 0.05
    transfer = TransferFunction((0.3, 1.0), (0.1, 0.4, 1.0), dead_s)
    early = control.forced_response(transfer.to_control(), time_s, values).outputs
    assert answer(TransferFunction((0.3, 1.0), (0.1, 0.4, 1.0)), time_s, values) == pytest.approx(
        early, abs=1e-7
    )
    whole = round(dead_s / 0.05)
    late = answer(TransferFunction((0.3, 1.0), (0.1, 0.4, 1.0), whole * 0.05), time_s, values)
    assert late[whole:] == pytest.approx(early[: 200 - whole], abs=1e-7)


def test_gain_lag_and_dead_time_come_back_without_noise():
    truth = TransferFunction.first_order(0.00912, 0.34, 0.287)
    fit = fit_transfer(
        trials_of(truth, np.random.default_rng(0), noise=0.0), Shape(1, 0), rng=np.random.default_rng(0)
    )
    assert fit.transfer.gain == pytest.approx(0.00912, rel=1e-5)
    assert fit.transfer.lag_s == pytest.approx(0.34, rel=1e-4)
    assert fit.transfer.dead_s == pytest.approx(0.287, abs=1e-4)


def test_an_average_over_the_cycle_is_taken_out_of_lag_and_dead_time():
    truth = TransferFunction.first_order(0.00912, 0.34, 0.28)
    trials = trials_of(truth, np.random.default_rng(0), noise=0.0, averaged=36)
    fit = fit_transfer(trials, Shape(1, 0), rng=np.random.default_rng(0))
    assert fit.transfer.lag_s == pytest.approx(0.34, rel=1e-3)
    assert fit.transfer.dead_s == pytest.approx(0.28, abs=1e-3)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    truth = TransferFunction.first_order(0.00912, 0.34, 0.28)
    held = np.zeros(3)
    for seed in range(14):
        rng = np.random.default_rng(seed)
        fit = fit_transfer(trials_of(truth, rng, count=4), Shape(1, 0), rng=rng, starts=1)
        for index, (quantity, value) in enumerate(
            [
                (lambda transfer: transfer.gain, 0.00912),
                (lambda transfer: transfer.lag_s, 0.34),
                (lambda transfer: transfer.dead_s, 0.28),
            ]
        ):
            low, high = fit.estimate(quantity, "").ci95
            held[index] += low <= value <= high
    assert np.all(held >= 11), held


@pytest.mark.parametrize("lag_s", [1000.0, 1e6])
def test_of_a_lag_that_outlasts_the_record_the_least_lag_and_the_slope_are_told(lag_s):
    """An integrator is the limit of a lag that grows with its gain."""
    slope, rng = 0.005, np.random.default_rng(1)
    truth = TransferFunction.first_order(slope * lag_s, lag_s, 0.3)
    fit = fit_transfer(trials_of(truth, rng, count=4), Shape(1, 0), rng=rng, starts=1)
    signals = SignalSet("steps", "run", (), {}, 0)
    result = summarise("fopdt", {"level": fit}, signals)
    lag, gain = result.parameters["level_lag"], result.parameters["level_gain"]
    assert lag.ci95[0] < lag_s < lag.ci95[1] == np.inf
    assert gain.ci95[0] < slope * lag_s < gain.ci95[1] == np.inf
    low, high = result.parameters["level_gain_over_lag"].ci95
    assert low < slope < high < 1.2 * low
    (message,) = [warning for warning in result.warnings if "lag" in warning]
    assert "level: the record is too short to tell the lag" in message
    assert "gain/lag = 0.0050" in message
    assert "inf" in result.to_text()


def test_a_lag_that_the_record_tells_has_both_ends_of_its_interval():
    rng = np.random.default_rng(0)
    truth = TransferFunction.first_order(0.5, 100.0, 0.3)
    fit = fit_transfer(trials_of(truth, rng, count=4), Shape(1, 0), rng=rng, starts=1)
    low, high = fit.estimate(lambda transfer: transfer.lag_s, "s").ci95
    assert low < 100.0 < high < 200.0
    assert warnings_of(fit, "level") == []


def test_a_dead_time_at_its_upper_bound_is_told():
    rng = np.random.default_rng(0)
    truth = TransferFunction.first_order(0.01, 0.3, 6.0)
    fit = fit_transfer(trials_of(truth, rng, count=4), Shape(1, 0), rng=rng, starts=1)
    assert any("dead time ended at its upper bound" in warning for warning in warnings_of(fit, "level"))


def test_an_input_that_never_moves_is_refused():
    rng = np.random.default_rng(0)
    still = [
        ResponseTrial("trial 0", TIME_S, np.zeros(len(TIME_S)), rng.standard_normal(len(TIME_S)), TIME_S >= 0)
    ]
    with pytest.raises(FitError, match="input does not change"):
        fit_transfer(still, Shape(1, 0), rng=rng)


def test_coefficients_survive_toml_and_a_response_is_chosen_by_name():
    order = TransferFunction.first_order(
        0.0091, 0.34, 0.28, input_name="gait.a", input_unit="deg", output_unit="N"
    )
    other = TransferFunction((1.0, 2.0), (1.0, 0.3, 4.0), 0.1)
    assert TransferFunction.from_toml(tomli_w.dumps(order.to_table())) == order
    text = f"[magnitude]\n{tomli_w.dumps(order.to_table())}\n[angle]\n{tomli_w.dumps(other.to_table())}"
    assert TransferFunction.from_toml(text, "angle") == other
    with pytest.raises(RequestError, match='did you mean "magnitude"'):
        TransferFunction.from_toml(text, "magnitud")
    with pytest.raises(RequestError, match=r"fit\.toml:2:1: lag .*did you mean 'lag_s'|lag_s"):
        TransferFunction.from_toml("gain = 1\nlag = 2\n", name="fit.toml")
