"""Damping in proportion to speed."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-coefficient * rate``."""
    return -values[0] * rate


EFFECT = Effect(
    id="viscous-damping",
    kind="joint",
    parameters=(
        EffectParameter("coefficient", "damping", neutral=0.0, lower=-1.0, upper=10.0, starts=(0.05, 0.3)),
    ),
    function=force_law(law),
    form="F = -coefficient rate",
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
)
