"""A command that cannot change faster than so."""

import math

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import rate_limit

EFFECT = Effect(
    id="rate-limit",
    kind="input",
    parameters=(
        EffectParameter(
            "rate", "signal-rate", neutral=math.inf, lower=0.05, upper=200.0, starts=(3.0, 1.0, 10.0, 30.0)
        ),
    ),
    function=signal_filter(rate_limit),
    form="y follows the signal, |dy/dt| at most rate",
    source="slew-rate limit of actuators; Khalil, Nonlinear Systems (2002), section 1.2",
)
