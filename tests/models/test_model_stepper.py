import json

import numpy as np
import pytest
from equations import OSCILLATOR
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import Stepper, parse_model, simulate

MODEL = parse_model(OSCILLATOR, "oscillator.toml")
STEP_S = 2e-3
COUNT = 600
DRIVE = np.sin(np.arange(COUNT + 1) * STEP_S * 9.0)[:, None]


def _effects():
    return [
        load_effect("coulomb-friction").attach("hinge", torque=0.2),
        load_effect("added-inertia").attach("hinge", inertia=0.4),
        load_effect("delay", "input").attach("torque", delay=0.0337),
        load_effect("lag", "output").attach("angle", time_constant=0.05),
        load_effect("delay", "output").attach("angle", delay=0.0123),
    ]


def _stepper():
    return Stepper(MODEL, None, {}, _effects(), STEP_S, initial_state=[0.3, 0.0])


WHOLE = _stepper().advance(DRIVE)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(1, 200), min_size=1, max_size=12), st.booleans())
def test_blocks_and_snapshots_change_nothing(sizes, interrupted):
    stepper, parts, begin = _stepper(), [], 0
    for size in [*sizes, COUNT]:
        end = min(begin + size, COUNT)
        parts.append(stepper.advance(DRIVE[begin : end + 1]))
        begin = end
        if interrupted:
            stored = json.dumps(stepper.snapshot(), allow_nan=False)
            stepper = _stepper()
            stepper.restore(json.loads(stored))
    assert np.array_equal(np.concatenate(parts), WHOLE)


def test_a_stepper_agrees_with_a_simulation():
    time_s = np.arange(COUNT + 1) * STEP_S
    result = simulate(MODEL, time_s, DRIVE, initial_state=[0.3, 0.0], effects=_effects(), substeps=1)
    assert pytest.approx(result.outputs[1:], abs=1e-12) == WHOLE


def test_a_held_input_is_given_at_start_middle_and_end_of_a_step():
    held = np.repeat(DRIVE[:-1, None, :], 3, axis=1)
    stepper = Stepper(MODEL, step_s=STEP_S, initial_state=[0.3, 0.0])
    result = simulate(
        MODEL.with_between({"torque": "hold"}),
        np.arange(COUNT + 1) * STEP_S,
        DRIVE,
        initial_state=[0.3, 0.0],
        substeps=1,
    )
    assert stepper.advance(held)[:, 0] == pytest.approx(result.outputs[1:, 0], abs=1e-13)
    assert stepper.state == pytest.approx(result.states[-1], abs=1e-13)


def test_the_state_can_be_set():
    stepper = Stepper(MODEL, step_s=STEP_S)
    stepper.state = np.array([1.0, 2.0])
    assert stepper.state.tolist() == [1.0, 2.0]
    with pytest.raises(ModelError, match="has 2 states"):
        stepper.state = np.zeros(3)


def test_a_stepper_that_blows_up_is_not_finite_any_more():
    model = parse_model('name = "burst"\nstates = ["y"]\n[equations]\ny = "y^2"\n[outputs]\ny = "y"', "b")
    stepper = Stepper(model, step_s=0.1, initial_state=[1.0])
    outputs = stepper.advance(np.empty((61, 0)))
    assert not stepper.finite
    assert np.isnan(outputs[-1, 0])
    assert np.isnan(stepper.advance(np.empty((3, 0)))).all()


@pytest.mark.parametrize("shape", [(4,), (4, 2), (4, 3, 2), (0, 1)])
def test_inputs_of_another_shape_are_an_error(shape):
    with pytest.raises(ModelError, match=r"was expected, not"):
        Stepper(MODEL).advance(np.zeros(shape))


def test_a_snapshot_of_something_else_is_refused():
    with pytest.raises(ModelError, match="another model or other effects"):
        Stepper(MODEL).restore(_stepper().snapshot())
