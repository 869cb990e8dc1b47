"""A signal that is a constant too large or too small."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import bias

_PARAMETERS = (EffectParameter("offset", "signal", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1, -0.1)),)
_FORM = "y = signal + offset"
_SOURCE = "zero error of a transducer; JCGM 200:2012 (VIM), 4.28 zero error"

INPUT = Effect("bias", "input", _PARAMETERS, signal_filter(bias), _FORM, _SOURCE)
OUTPUT = Effect("bias", "output", _PARAMETERS, signal_filter(bias), _FORM, _SOURCE)
EFFECT = (INPUT, OUTPUT)
