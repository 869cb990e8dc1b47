"""Dry friction that is greater at rest than in motion."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.effects.transition import TRANSITION_SPEED
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-(torque + static_excess exp(-(rate / stribeck_speed)^2)) tanh(rate / transition_speed)``."""
    ratio = rate / values[2]
    level = values[0] + values[1] * math.exp(-ratio * ratio)
    return -level * math.tanh(rate / values[3])


EFFECT = Effect(
    id="stribeck-friction",
    kind="joint",
    parameters=(
        EffectParameter("torque", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
        EffectParameter("static_excess", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
        EffectParameter("stribeck_speed", "rate", neutral=None, lower=0.005, upper=0.5, starts=(0.1, 0.03)),
        TRANSITION_SPEED,
    ),
    function=force_law(law),
    form="F = -(torque + static_excess exp(-(rate / stribeck_speed)^2)) tanh(rate / transition_speed)",
    contains=("coulomb-friction",),
    source="Stribeck 1902; the form is that of Bo and Pavelescu, Wear 82 (1982) 277",
)
