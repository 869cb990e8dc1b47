"""Dry friction in proportion to the load that the joint carries."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.effects.transition import TRANSITION_SPEED
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-coefficient * |load| * tanh(rate / transition_speed)``."""
    return -values[0] * abs(load) * math.tanh(rate / values[1])


EFFECT = Effect(
    id="load-dependent-friction",
    kind="joint",
    parameters=(
        EffectParameter("coefficient", "ratio", neutral=0.0, lower=0.0, upper=1.0, starts=(0.02, 0.1)),
        TRANSITION_SPEED,
    ),
    function=force_law(law),
    form="F = -coefficient |load| tanh(rate / transition_speed); the coefficient is in units of force per load",
    source="Amontons 1699; robot joints: Bittencourt and Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012) 051013",
    needs=("load",),
)
