"""A spring that gives way slowly while it is held (standard linear solid)."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-stiffness (q - z)``, where z follows q with the time constant."""
    dz[0] = (q - z[0]) / values[1]
    return -values[0] * (q - z[0])


EFFECT = Effect(
    id="viscoelastic-creep",
    kind="joint",
    parameters=(
        EffectParameter("stiffness", "stiffness", neutral=0.0, lower=0.0, upper=2.0, starts=(0.1, 0.4)),
        EffectParameter("time_constant", "time", neutral=None, lower=0.01, upper=5.0, starts=(0.3, 1.0)),
    ),
    function=force_law(law),
    form="F = -stiffness (q - z), time_constant dz/dt = q - z",
    source="Maxwell branch of the standard linear solid; Ferry, Viscoelastic Properties of Polymers (1980), chapter 1",
    states=1,
)
