"""Waves that the body makes, and that come back from the walls."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``coefficient`` times what ``|rate| rate`` was `delay` ago, by a Pade approximation of second order."""
    made = abs(rate) * rate
    dz[0] = z[1]
    dz[1] = made - 12.0 / (values[1] * values[1]) * z[0] - 6.0 / values[1] * z[1]
    return values[0] * (made - 12.0 / values[1] * z[1])


EFFECT = Effect(
    id="wall-echo",
    kind="body",
    parameters=(
        EffectParameter("coefficient", "drag", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.3, -0.3)),
        EffectParameter("delay", "time", neutral=None, lower=0.05, upper=2.0, starts=(0.3, 0.8)),
    ),
    function=force_law(law),
    form="F = coefficient (|rate| rate) one delay ago",
    source="waves reflected by the tank, suspected in section 5.4 of the source work; Pade approximation of the delay",
    states=2,
)
