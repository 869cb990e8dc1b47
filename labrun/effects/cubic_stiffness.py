"""A spring that hardens or softens with the cube of its excursion."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-coefficient * q**3``."""
    return -values[0] * q * q * q


EFFECT = Effect(
    id="cubic-stiffness",
    kind="joint",
    parameters=(
        EffectParameter(
            "coefficient", "cubic-stiffness", neutral=0.0, lower=-1.0, upper=2.0, starts=(0.1, -0.1)
        ),
    ),
    function=force_law(law),
    form="F = -coefficient q^3",
    source="Duffing, Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz (1918)",
)
