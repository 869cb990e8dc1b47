"""Dry friction of constant torque."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.effects.transition import TRANSITION_SPEED
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-torque * tanh(rate / transition_speed)``."""
    return -values[0] * math.tanh(rate / values[1])


EFFECT = Effect(
    id="coulomb-friction",
    kind="joint",
    parameters=(
        EffectParameter("torque", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
        TRANSITION_SPEED,
    ),
    function=force_law(law),
    form="F = -torque tanh(rate / transition_speed)",
    source="Coulomb 1785; smoothed sign as in Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083",
)
