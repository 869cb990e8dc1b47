"""Stops that the joint runs into, on either side."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import math

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return the force of a damped spring beyond `upper` and below `lower`; it never pulls."""
    deep = max(q - values[0], 0.0) + min(q - values[1], 0.0)
    if deep == 0.0:
        return 0.0
    force = -values[2] * deep * (1.0 + values[3] * rate * (1.0 if deep > 0.0 else -1.0))
    return min(force, 0.0) if deep > 0.0 else max(force, 0.0)


EFFECT = Effect(
    id="end-stop",
    kind="joint",
    parameters=(
        # at 1.2 times the peak excursion a stop is out of reach: the starts try both sides, and each alone
        EffectParameter(
            "upper", "coordinate", neutral=math.inf, lower=0.05, upper=1.5, starts=(0.8, 0.8, 1.2)
        ),
        EffectParameter(
            "lower", "coordinate", neutral=-math.inf, lower=-1.5, upper=-0.05, starts=(-0.8, -1.2, -0.8)
        ),
        EffectParameter("stiffness", "stiffness", neutral=None, lower=0.5, upper=100.0, starts=(5.0,)),
        EffectParameter(
            "damping_time",
            "time-per-coordinate",
            neutral=None,
            lower=0.0,
            upper=1.0,
            starts=(0.0,),
            held=True,
        ),
    ),
    function=force_law(law),
    form="F = -stiffness depth (1 + damping_time rate) beyond upper or lower, 0 between",
    source="Hunt and Crossley, J. Applied Mechanics 42 (1975) 440, with exponent 1",
)
