"""A signal that follows with a first-order lag."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import lag

_PARAMETERS = (
    EffectParameter("time_constant", "time", neutral=0.0, lower=0.0, upper=0.5, starts=(0.02, 0.1)),
)
_FORM = "time_constant dy/dt = signal - y, at rest in the beginning"
_SOURCE = "first-order lag; Astrom and Murray, Feedback Systems (2008), section 2.2"

INPUT = Effect("lag", "input", _PARAMETERS, signal_filter(lag), _FORM, _SOURCE)
OUTPUT = Effect("lag", "output", _PARAMETERS, signal_filter(lag), _FORM, _SOURCE)
EFFECT = (INPUT, OUTPUT)
