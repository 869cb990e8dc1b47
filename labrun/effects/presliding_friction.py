"""Dry friction that gives way like a spring before it slides (LuGre)."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-torque (z + damping_time dz/dt)``; z is the bristles' deflection in units of `presliding`.

    ``dz/dt = (rate - |rate| z / g) / presliding`` with ``g = 1 + static_excess exp(-(rate / stribeck_speed)^2)``.
    """
    ratio = rate / values[3]
    level = 1.0 + values[2] * math.exp(-ratio * ratio)
    dz[0] = (rate - abs(rate) * z[0] / level) / values[1]
    return -values[0] * (z[0] + values[4] * dz[0])


EFFECT = Effect(
    id="presliding-friction",
    kind="joint",
    parameters=(
        EffectParameter("torque", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
        EffectParameter("presliding", "coordinate", neutral=None, lower=2e-3, upper=0.5, starts=(0.05, 0.01)),
        EffectParameter(
            "static_excess", "ratio", neutral=None, lower=0.0, upper=2.0, starts=(0.0,), held=True
        ),
        EffectParameter(
            "stribeck_speed", "rate", neutral=None, lower=0.005, upper=0.5, starts=(0.05,), held=True
        ),
        EffectParameter(
            "damping_time", "time", neutral=None, lower=0.0, upper=0.01, starts=(1e-4,), held=True
        ),
    ),
    function=force_law(law),
    form="F = -torque (z + damping_time dz/dt), dz/dt = (rate - |rate| z / g(rate)) / presliding",
    contains=("coulomb-friction", "hysteresis"),
    source="Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automatic Control 40 (1995) 419",
    states=1,
)
