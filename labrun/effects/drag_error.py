"""Fluid drag that is larger or smaller than the model has it."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-coefficient * |rate| * rate``; the coefficient may be negative."""
    return -values[0] * abs(rate) * rate


EFFECT = Effect(
    id="drag-error",
    kind="body",
    parameters=(
        EffectParameter("coefficient", "drag", neutral=0.0, lower=-1.0, upper=2.0, starts=(0.1, -0.1)),
    ),
    function=force_law(law),
    form="F = -coefficient |rate| rate, coefficient the error of density drag_coefficient area / 2",
    source="Hoerner, Fluid-Dynamic Drag (1965): drag at high Reynolds number, error of its coefficient",
)
