"""The joints of a bench as a model without states, so that effects can sit between command and joint."""

import functools
from collections.abc import Sequence
from typing import Any

from labrun.effects import AttachedEffect
from labrun.models import Input, Model, Output, Stepper, native


def _nothing(t: float, x: Any, u: Any, p: Any, force: Any, out: Any) -> None:
    """No state changes, and no site takes a force."""


def _pass_on(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output = input, as many as the first parameter says."""
    for i in range(int(p[0])):
        y[i] = u[i]


@functools.cache
def joint_model(joints: tuple[str, ...]) -> Model:
    """Return the model whose inputs and outputs are the joints' angles, rad."""
    import numpy as np

    return Model(
        name="joints",
        states=(),
        inputs=tuple(Input(joint, "rad") for joint in joints),
        outputs=tuple(Output(joint, "rad") for joint in joints),
        parameters=(),
        conditions=(),
        sites=(),
        initial={},
        derivative=native("model", _nothing),
        output=native("model", _pass_on),
        site_values=native("model", _nothing),
        constants=np.array([float(len(joints))]),
        source="joints of a simulated bench",
    )


def joint_stepper(joints: tuple[str, ...], step_s: float, effects: Sequence[AttachedEffect] = ()) -> Stepper:
    """Return what turns commanded into true joint angles, with the effects that hide there."""
    return Stepper(joint_model(joints), effects=effects, step_s=step_s)
