"""Waves that the body makes, and that come back from the walls."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer

_SECTIONS = 4


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``coefficient`` times what ``|rate| rate`` was `delay` ago.

    Four Pade approximations of second order, each of a quarter of the delay, one behind the other: right to 1 % of the
    phase up to an angular frequency of 7 / delay.
    """
    part = values[1] / _SECTIONS
    signal = abs(rate) * rate
    for section in range(_SECTIONS):
        place = 2 * section
        dz[place] = z[place + 1]
        dz[place + 1] = signal - 12.0 / (part * part) * z[place] - 6.0 / part * z[place + 1]
        signal -= 12.0 / part * z[place + 1]
    return values[0] * signal


EFFECT = Effect(
    id="wall-echo",
    kind="body",
    parameters=(
        EffectParameter("coefficient", "drag", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.3, -0.3)),
        EffectParameter("delay", "time", neutral=None, lower=0.1, upper=2.0, starts=(0.3, 0.8)),
    ),
    function=force_law(law),
    form="F = coefficient (|rate| rate) one delay ago",
    source="waves reflected by the tank, suspected in section 5.4 of the source work; the delay by Pade approximations",
    states=2 * _SECTIONS,
)
