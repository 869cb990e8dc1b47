"""Dry friction with a level for each direction of motion: a ratchety gearbox, a seal, one layer that rubs."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.effects.transition import TRANSITION_SPEED
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-torque (1 + asymmetry s) s`` with ``s = tanh(rate / transition_speed)``.

    The level is ``torque (1 + asymmetry)`` forwards, ``torque (1 - asymmetry)`` backwards: in motion Coulomb friction
    and a constant force, ``-torque asymmetry``, which at rest is not there.
    """
    sign = math.tanh(rate / values[2])
    return -values[0] * (1.0 + values[1] * sign) * sign


EFFECT = Effect(
    id="asymmetric-friction",
    kind="joint",
    parameters=(
        EffectParameter("torque", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
        # beyond one, friction would push; with no torque nothing depends on it, so a fit begins on either side
        EffectParameter("asymmetry", "ratio", neutral=None, lower=-1.0, upper=1.0, starts=(0.4, -0.4)),
        TRANSITION_SPEED,
    ),
    function=force_law(law),
    form="F = -torque (1 + asymmetry s) s, s = tanh(rate / transition_speed)",
    contains=("coulomb-friction",),
    compound=True,
    caution="Coulomb friction beside a constant pull (a tilt) looks the same while the joint moves: turn gravity round",
    source="levels as in Canudas de Wit, Astrom, Braun, IEEE J. Robotics and Automation 3 (1987) 681; smoothed sign",
)
