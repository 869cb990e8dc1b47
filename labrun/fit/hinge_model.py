"""Eq. (3.5), with what is known of the body that swings."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import FitError

if TYPE_CHECKING:
    from labrun.models import Model, Parameter

FOUND = ("stiffness", "damping")
"""What a hinge fit is for; always free."""


def hinge_model(known: "Model | None") -> "Model":
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
    from labrun.models import load_model

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


def _taken_over(parameter: "Parameter", stated: "dict[str, Parameter]") -> "Parameter":
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
    def of(cls, model: "Model") -> "Body":
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


def taken_as_stated(model: "Model") -> "Model":
    """Return the model with the body's numbers fixed, as far as they are known."""
    parameters = [
        parameter
        if parameter.name in FOUND or parameter.tolerance == "free"
        else replace(parameter, tolerance=0.0)
        for parameter in model.parameters
    ]
    return replace(model, parameters=tuple(parameters))
