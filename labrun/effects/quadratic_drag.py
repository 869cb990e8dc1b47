"""Drag in proportion to the square of speed."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-coefficient * |rate| * rate``."""
    return -values[0] * abs(rate) * rate


EFFECT = Effect(
    id="quadratic-drag",
    kind="joint",
    parameters=(
        EffectParameter("coefficient", "drag", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
    ),
    function=force_law(law),
    form="F = -coefficient |rate| rate",
    source="Batchelor, An Introduction to Fluid Dynamics (1967), section 5.11: drag at high Reynolds number",
)
