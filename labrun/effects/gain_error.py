"""A signal that is a constant factor too large or too small."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import gain_error

_PARAMETERS = (EffectParameter("error", "ratio", neutral=0.0, lower=-0.9, upper=2.0, starts=(0.1, -0.1)),)
_FORM = "y = (1 + error) signal"
_SOURCE = "calibration error of a linear transducer; JCGM 200:2012 (VIM), 4.12 sensitivity"

INPUT = Effect("gain-error", "input", _PARAMETERS, signal_filter(gain_error), _FORM, _SOURCE)
OUTPUT = Effect("gain-error", "output", _PARAMETERS, signal_filter(gain_error), _FORM, _SOURCE)
EFFECT = (INPUT, OUTPUT)
