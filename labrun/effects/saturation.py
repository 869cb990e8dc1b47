"""A signal that cannot leave a range."""

import math

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import saturation

_PARAMETERS = (
    # above the peak of the signal a level is never reached: a search has to begin below it
    EffectParameter("level", "signal", neutral=math.inf, lower=0.05, upper=1.5, starts=(0.9, 0.6)),
    EffectParameter("knee", "ratio", neutral=None, lower=0.0, upper=1.0, starts=(0.0, 0.1, 0.4), held=True),
)
_FORM = "y = signal, cut at -level and level; a knee k makes the corner a parabola, from (1 - k) level to (1 + k) level"
_SOURCE = (
    "Khalil, Nonlinear Systems (2002), section 1.2.7; the knee as in Giannoulis et al., J. Audio Eng. Soc. 60 "
    "(2012) 399"
)

INPUT = Effect("saturation", "input", _PARAMETERS, signal_filter(saturation), _FORM, _SOURCE)
OUTPUT = Effect("saturation", "output", _PARAMETERS, signal_filter(saturation), _FORM, _SOURCE)
EFFECT = (INPUT, OUTPUT)
