"""The body that hangs on a specimen: its mass properties from a model whose equations use the trial's condition."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.errors import FitError
from labrun.fit.hinge_model import FOUND

if TYPE_CHECKING:
    from labrun.models import Model

FloatArray = NDArray[np.float64]
Condition = Mapping[str, float | str]

_STEP = 1e-4
"""Relative step of the derivatives with respect to the model's parameters."""
_CLOSE = 1e-6


@dataclass(frozen=True, slots=True)
class SpecimenBody:
    """What swings on one specimen.

    Attributes
    ----------
    inertia, gravity_torque
        I_G + m r^2 (kg m^2) and m g r (N m).
    by_tolerance : (q, 2)
        Relative change of both when one of the model's stated parameters is off by its tolerance; one row a parameter.
    """

    inertia: float
    gravity_torque: float
    by_tolerance: FloatArray

    def shift(self, stiffness: float, damping: float) -> tuple[float, float]:
        """Return the relative standard deviations of k and b that the parameters' tolerances amount to.

        Frequency and decay fix ``(k + m g r) / I`` and ``b / I``: a wrong body makes a wrong k and b.
        """
        of_inertia, of_gravity = self.by_tolerance.T
        k = (stiffness + self.gravity_torque) * of_inertia - self.gravity_torque * of_gravity
        b = damping * of_inertia
        size = max(abs(stiffness), 1e-300), max(abs(damping), 1e-300)
        return float(np.linalg.norm(k)) / size[0], float(np.linalg.norm(b)) / size[1]


def body_of(model: "Model", condition: Condition) -> SpecimenBody:
    """Return the body of one specimen as the model states it.

    The equation of motion is asked for it: ``I theta'' = torque - k theta - b theta' - m g r sin(theta)``, so that
    1 N m on the flat hinge gives the inertia, and the horizontal body without a spring the gravity torque.

    Raises
    ------
    FitError
        A model that is not eq. (3.5), or one that leaves a number of the body free.
    ModelError
        The equations use a condition that the trial does not have.
    """
    names = [parameter.name for parameter in model.parameters]
    _require_hinge(model, names)
    free = [one.name for one in model.parameters if one.tolerance == "free" and one.name not in FOUND]
    if free:
        raise FitError(
            f"hinge-maps needs the body, and model {model.name} leaves {', '.join(free)} free",
            hint="a swing alone gives ratios only: weigh and measure the body, and give tolerances",
        )
    nominal = dict.fromkeys(FOUND, 0.0)
    inertia, gravity = _properties(model, condition, nominal)
    rows = []
    for parameter in model.parameters:
        if isinstance(parameter.tolerance, str) or parameter.tolerance == 0.0 or parameter.name in FOUND:
            continue
        ends = [
            np.log(
                _properties(
                    model, condition, {**nominal, parameter.name: parameter.value * (1 + sign * _STEP)}
                )
            )
            for sign in (1.0, -1.0)
        ]
        rows.append(parameter.tolerance * (ends[0] - ends[1]) / (2 * _STEP))
    return SpecimenBody(inertia, gravity, np.array(rows).reshape(-1, 2))


def with_body(model: "Model", body: SpecimenBody) -> "Model":
    """Return the model's stiffness and damping beside a body that is known, for `labrun.fit.hinge.fit_hinge`."""
    from labrun.models.model import Parameter

    searched = tuple(parameter for parameter in model.parameters if parameter.name in FOUND)
    known = (
        Parameter("inertia", body.inertia, 0.0, "kg m^2"),
        Parameter("gravity_torque", body.gravity_torque, 0.0, "N m"),
    )
    return replace(model, parameters=(*known, *searched))


def _require_hinge(model: "Model", names: list[str]) -> None:
    missing = [name for name in FOUND if name not in names]
    joints = [site.name for site in model.sites if site.kind == "joint"]
    if missing or len(model.states) != 2 or len(joints) != 1 or len(model.outputs) != 1 or model.inputs:
        what = f"has no parameter {' and '.join(missing)}" if missing else "is not one body on one hinge"
        raise FitError(
            f"hinge-maps fits eq. (3.5), and model {model.name} {what}",
            hint="it needs two states (angle, rate), one output (the angle), one joint site, and the parameters "
            "stiffness and damping: models/hinge-specimens.toml is such a model",
        )


def _properties(model: "Model", condition: Condition, values: Mapping[str, float]) -> tuple[float, float]:
    p = model.vector(values, condition)
    derivative = model.derivative.python
    column = model.states.index(model.outputs[0].name) if model.outputs[0].name in model.states else 0

    def acceleration(angle: float, torque: float) -> float:
        x, out, force = np.zeros(2), np.zeros(2), np.zeros(len(model.sites))
        x[column] = angle
        force[[site.kind == "joint" for site in model.sites]] = torque
        derivative(0.0, x, np.zeros(0), p, force, out)
        return float(out[1 - column])

    at_rest = acceleration(0.0, 0.0)
    per_torque = acceleration(0.0, 1.0) - at_rest
    horizontal, inclined = acceleration(np.pi / 2, 0.0), acceleration(np.pi / 6, 0.0)
    if not (np.isfinite(per_torque) and per_torque > 0 and np.isfinite(horizontal) and horizontal < 0):
        raise FitError(
            f"model {model.name} has no inertia or no weight at {_told(condition)}",
            hint="are all numbers of the body positive, and in the units that the model states?",
        )
    size = abs(horizontal)
    if abs(at_rest) > _CLOSE * size or abs(inclined - 0.5 * horizontal) > _CLOSE * size:
        raise FitError(
            f"without spring and damper, model {model.name} is no pendulum: its acceleration does not follow "
            "the sine of the angle",
            hint="eq. (3.5) is I angle'' = -k angle - b angle' - m g r sin(angle)",
        )
    return 1.0 / per_torque, -horizontal / per_torque


def _told(condition: Condition) -> str:
    return ", ".join(f"{name} {value}" for name, value in condition.items()) or "no condition"
