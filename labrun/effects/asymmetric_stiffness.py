"""A spring that is stiffer, or softer, on one side: one-sided buckling."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-excess * max(q, 0)``; the excess may be negative."""
    return -values[0] * max(q, 0.0)


EFFECT = Effect(
    id="asymmetric-stiffness",
    kind="joint",
    parameters=(
        EffectParameter("excess", "stiffness", neutral=0.0, lower=-1.0, upper=2.0, starts=(0.1, -0.1)),
    ),
    function=force_law(law),
    form="F = -excess q for q > 0, 0 elsewhere; the other side has the model's own stiffness",
    source="bilinear spring; for curved beams that buckle one way only, chapter 7 of the source work",
)
