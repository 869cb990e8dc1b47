"""Play in the joint's own spring: within it, nothing pulls."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``stiffness * q`` cut at plus and minus half the gap: it takes the spring away within the play."""
    half = 0.5 * values[0]
    return stiffness * min(max(q, -half), half)


EFFECT = Effect(
    id="backlash",
    kind="joint",
    parameters=(EffectParameter("gap", "coordinate", neutral=0.0, lower=0.0, upper=1.5, starts=(0.1, 0.4)),),
    function=force_law(law),
    form="-stiffness q + F = -stiffness dead_zone(q, gap / 2)",
    source="Nordin and Gutman, Automatica 38 (2002) 1633: dead-zone model of backlash",
    needs=("stiffness",),
)
