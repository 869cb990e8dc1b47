"""A signal that arrives late."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import delay, delay_memory

_PARAMETERS = (EffectParameter("delay", "time", neutral=0.0, lower=0.0, upper=0.5, starts=(0.02, 0.1)),)
_FORM = "y(t) = signal(t - delay), the signal straight between the integrator's steps and constant before the first"
_SOURCE = "transport delay; Astrom and Wittenmark, Computer-Controlled Systems (1997), section 2.2"

INPUT = Effect("delay", "input", _PARAMETERS, signal_filter(delay), _FORM, _SOURCE, memory=delay_memory)
OUTPUT = Effect("delay", "output", _PARAMETERS, signal_filter(delay), _FORM, _SOURCE, memory=delay_memory)
EFFECT = (INPUT, OUTPUT)
