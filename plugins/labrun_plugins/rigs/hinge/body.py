"""Eq. (3.5) and the body that swings: as a model states it, for one hinge or for the trial of every specimen."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import FitError
from labrun.models import Model, Parameter, load_model

Condition = Mapping[str, float | str]

FOUND = ("stiffness", "damping")
"""What a hinge fit is for; always free."""
_STEP = 1e-4
"""Relative step of the derivatives with respect to the model's parameters."""
_CLOSE = 1e-6


def hinge_model(known: Model | None) -> Model:
    """Return eq. (3.5) with what another model knows of the body.

    Parameters
    ----------
    known
        A model with the parameters `inertia` (I_G + m r^2, kg m^2) and `gravity_torque` (m g r, N m), such as
        that of the experiment or of a recording; values and tolerances are taken over, those of `stiffness` and
        `damping` too where it has them.

    Raises
    ------
    FitError
        No model, one that knows neither, or one that leaves the inertia free: a swing gives ratios to it only.
    """
    model = load_model(Path(__file__).with_name("hinge.toml"))
    stated = {} if known is None else {parameter.name: parameter for parameter in known.parameters}
    missing = [name for name in ("inertia", "gravity_torque") if name not in stated]
    if missing:
        source = "no model says" if known is None else f"model {known.name} does not have"
        raise FitError(
            f"a hinge fit needs the body's {' and '.join(missing)}, which {source}",
            hint="a swing alone gives ratios only: name a model with the parameters inertia (kg m^2) and "
            "gravity_torque (N m) by --model",
        )
    if stated["inertia"].tolerance == "free":
        raise FitError(
            "a hinge fit needs the body's inertia, which the model leaves free",
            hint="a swing alone gives ratios to it only: weigh and measure the body, and give the inertia the "
            "tolerance it is then known to",
        )
    parameters = tuple(_taken_over(parameter, stated) for parameter in model.parameters)
    angle = known.outputs[0].name if known is not None and known.outputs else "angle"
    if angle == "angle":
        return replace(model, parameters=parameters)
    outputs = tuple(replace(output, name=angle) for output in model.outputs)
    return replace(model, parameters=parameters, outputs=outputs)


def _taken_over(parameter: Parameter, stated: dict[str, Parameter]) -> Parameter:
    if parameter.name not in stated:
        return parameter
    other = stated[parameter.name]
    return replace(
        parameter, value=other.value, tolerance="free" if parameter.name in FOUND else other.tolerance
    )


@dataclass(frozen=True, slots=True)
class Body:
    """What swings.

    Attributes
    ----------
    inertia
        I_G + m r^2, kg m^2.
    gravity_torque
        m g r, N m; None where it is not known.
    inertia_tolerance, gravity_tolerance
        Relative standard deviations.
    """

    inertia: float
    gravity_torque: float | None
    inertia_tolerance: float
    gravity_tolerance: float

    @classmethod
    def of(cls, model: Model) -> "Body":
        """Return what a hinge model says of the body."""
        stated = {parameter.name: parameter for parameter in model.parameters}
        inertia, gravity = stated["inertia"], stated["gravity_torque"]
        free = gravity.tolerance == "free"
        return cls(
            inertia.value,
            None if free else gravity.value,
            0.0 if isinstance(inertia.tolerance, str) else inertia.tolerance,
            0.0 if isinstance(gravity.tolerance, str) else gravity.tolerance,
        )


def taken_as_stated(model: Model) -> Model:
    """Return the model with the body's numbers fixed, as far as they are known."""
    parameters = [
        parameter
        if parameter.name in FOUND or parameter.tolerance == "free"
        else replace(parameter, tolerance=0.0)
        for parameter in model.parameters
    ]
    return replace(model, parameters=tuple(parameters))


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


def body_of(model: Model, condition: Condition) -> SpecimenBody:
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
    free = [
        parameter.name
        for parameter in model.parameters
        if parameter.tolerance == "free" and parameter.name not in FOUND
    ]
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


def with_body(model: Model, body: SpecimenBody) -> Model:
    """Return the model's stiffness and damping beside a body that is known, for `fit_hinge`."""
    searched = tuple(parameter for parameter in model.parameters if parameter.name in FOUND)
    known = (
        Parameter("inertia", body.inertia, 0.0, "kg m^2"),
        Parameter("gravity_torque", body.gravity_torque, 0.0, "N m"),
    )
    return replace(model, parameters=(*known, *searched))


def _require_hinge(model: Model, names: list[str]) -> None:
    missing = [name for name in FOUND if name not in names]
    joints = [site.name for site in model.sites if site.kind == "joint"]
    if missing or len(model.states) != 2 or len(joints) != 1 or len(model.outputs) != 1 or model.inputs:
        what = f"has no parameter {' and '.join(missing)}" if missing else "is not one body on one hinge"
        raise FitError(
            f"hinge-maps fits eq. (3.5), and model {model.name} {what}",
            hint="it needs two states (angle, rate), one output (the angle), one joint site, and the parameters "
            "stiffness and damping: models/hinge-specimens.toml is such a model",
        )


def _properties(model: Model, condition: Condition, values: Mapping[str, float]) -> tuple[float, float]:
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
            f"without spring and damper, model {model.name} is not a pendulum: its acceleration does not follow "
            "the sine of the angle",
            hint="eq. (3.5) is I angle'' = -k angle - b angle' - m g r sin(angle)",
        )
    return 1.0 / per_torque, -horizontal / per_torque


def _told(condition: Condition) -> str:
    return ", ".join(f"{name} {value}" for name, value in condition.items()) or "no condition"
