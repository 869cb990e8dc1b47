"""The PID controller by itself, against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.control.pid import PidController
from labrun.control.protocol import LoopContext, Step
from labrun.errors import SpecError

CONTEXT = LoopContext(period_s=0.1, low=-1e9, high=1e9, start=0.0)
GAINS = st.floats(-100, 100)


def steps(controller, errors, *, dt_s=0.1, drive=0.0, reference=0.0):
    """Feed errors with a constant reference; return the outputs, each applied as it is."""
    results = []
    for number, error in enumerate(errors):
        step = Step(number * dt_s, dt_s, reference, reference - error, drive, lambda _: reference)
        results.append(controller.update(step))
        controller.applied(results[-1])
    return np.array(results)


@given(GAINS, GAINS, GAINS, st.lists(st.floats(-10, 10), min_size=1, max_size=20))
def test_the_output_is_the_sum_of_its_parts(p, i, bias, errors):
    output = steps(PidController({"p": p, "i": i, "bias": bias}, CONTEXT), errors)
    expected = bias + p * np.array(errors) + i * 0.1 * np.cumsum(errors)
    np.testing.assert_allclose(output, expected, rtol=1e-9, atol=1e-6)


def test_an_integral_per_sample_does_not_know_how_long_a_sample_takes():
    slow = steps(PidController({"i": 0.5, "i_per": "sample"}, CONTEXT), [1.0] * 10, dt_s=0.1)
    quick = steps(PidController({"i": 0.5, "i_per": "sample"}, CONTEXT), [1.0] * 10, dt_s=0.01)
    np.testing.assert_allclose(slow, quick)
    np.testing.assert_allclose(slow, 0.5 * np.arange(1, 11))


def test_the_derivative_of_a_ramp_is_its_slope_once_the_filter_has_settled():
    controller = PidController({"d": 2.0, "derivative_on": "error", "filter_s": 0.3}, CONTEXT)
    ramp = 0.7 * 0.1 * np.arange(100)
    output = steps(controller, ramp)
    assert output[0] == 0.0
    assert output[-1] == pytest.approx(2.0 * 0.7)
    # First order: after one time constant of three steps, 1 - (3/4)^n of the way.
    assert output[3] == pytest.approx(2.0 * 0.7 * (1 - 0.75**3))


def test_a_derivative_on_the_measurement_does_not_kick_when_the_reference_steps():
    on_error = PidController({"d": 1.0, "derivative_on": "error"}, CONTEXT)
    on_measurement = PidController({"d": 1.0}, CONTEXT)
    for controller in (on_error, on_measurement):
        controller.update(Step(0.0, 0.1, 0.0, 3.0, 0.0, lambda _: 0.0))
    step = Step(0.1, 0.1, 5.0, 3.0, 0.0, lambda _: 5.0)
    assert on_measurement.update(step) == 0.0
    assert on_error.update(step) > 10.0


@pytest.mark.parametrize("rule", ["conditional", "back-calculation"])
def test_the_integral_does_not_wind_up_against_the_range(rule):
    context = LoopContext(0.1, 0.0, 10.0, 0.0)
    outputs = {}
    for name in (rule, "none"):
        controller = PidController({"p": 1.0, "i": 1.0, "anti_windup": name}, context)
        for number in range(400):
            error = 5.0 if number < 300 else -1.0
            requested = controller.update(Step(0.1 * number, 0.1, error, 0.0, 0.0, lambda _: 0.0))
            controller.applied(min(max(requested, 0.0), 10.0))
            if number == 310:
                outputs[name] = requested
    assert outputs["none"] > 100.0
    assert outputs[rule] < 10.0


def test_conditional_integration_still_lets_the_output_come_back_into_the_range():
    controller = PidController({"i": 1.0}, LoopContext(0.1, 0.0, 10.0, 0.0))
    steps(controller, [10.0] * 50)
    back = steps(controller, [-10.0] * 3)
    assert np.all(np.diff(back) < 0)


def test_an_increment_is_added_to_where_the_variable_stands():
    output = steps(PidController({"p": 0.5, "output": "increment"}, CONTEXT), [4.0], drive=20.0)
    assert output[0] == 22.0


def test_a_wrong_key_is_named_with_what_was_meant():
    with pytest.raises(SpecError, match="anti_windup"):
        PidController({"p": 1.0, "anti_windp": "none"}, CONTEXT)
    with pytest.raises(SpecError, match="sample"):
        PidController({"i_per": "samples"}, CONTEXT)


@given(st.floats(0.05, 0.9), st.floats(0.1, 5))
def test_a_closed_loop_of_pi_and_a_lag_is_what_python_control_says(share, lag_s):
    """The sampled loop on an exactly stepped first-order lag, beside the same loop as transfer functions."""
    control = pytest.importorskip("control")
    period_s = lag_s / 50
    p, i = 2.0, share / lag_s
    decay = math.exp(-period_s / lag_s)
    controller = PidController({"p": p, "i": i}, LoopContext(period_s, -1e9, 1e9, 0.0))
    state, result = 0.0, []
    for number in range(200):
        result.append(state)
        drive = controller.update(Step(number * period_s, period_s, 1.0, state, 0.0, lambda _: 1.0))
        state = decay * state + (1 - decay) * drive
    z = control.TransferFunction([1, 0], [1], period_s)
    plant = control.TransferFunction([1 - decay], [1, -decay], period_s)
    loop = (p + i * period_s * z / (z - 1)) * plant
    _, expected = control.step_response(control.feedback(loop, 1), T=period_s * np.arange(200))
    np.testing.assert_allclose(result, np.squeeze(expected), atol=1e-9)
