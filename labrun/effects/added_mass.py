"""Fluid that has to move with the body, and that the model does not have."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-mass * acceleration``."""
    return -values[0] * acceleration


EFFECT = Effect(
    id="added-mass",
    kind="body",
    parameters=(EffectParameter("mass", "inertia", neutral=0.0, lower=-0.5, upper=2.0, starts=(0.1, -0.1)),),
    function=force_law(law),
    form="F = -mass d(rate)/dt, solved together with the model",
    source="Lamb, Hydrodynamics (1932), section 92; Newman, Marine Hydrodynamics (1977), section 4.13",
    needs_acceleration=True,
)
