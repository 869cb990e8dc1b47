"""A sensor whose zero moves steadily over the trial."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import drift

EFFECT = Effect(
    id="drift",
    kind="output",
    parameters=(
        EffectParameter("slope", "signal-rate", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.05, -0.05)),
    ),
    function=signal_filter(drift),
    form="y = signal + slope t",
    source="linear drift of the zero, as of strain-gauge force/torque sensors that warm up",
)
