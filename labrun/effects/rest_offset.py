"""A spring whose rest position is not where the model has it."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``stiffness * offset``: the site's spring then pulls towards the offset."""
    return stiffness * values[0]


EFFECT = Effect(
    id="rest-offset",
    kind="joint",
    parameters=(
        EffectParameter("offset", "coordinate", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1, -0.1)),
    ),
    function=force_law(law),
    form="F = stiffness offset, so that -stiffness q + F = -stiffness (q - offset)",
    source="linear spring about another rest position; for laminate hinges, the set left by fabrication",
    needs=("stiffness",),
)
