"""A command that has to leave a band around zero before anything happens."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import dead_band

EFFECT = Effect(
    id="dead-band",
    kind="input",
    parameters=(
        EffectParameter("half_width", "signal", neutral=0.0, lower=0.0, upper=0.8, starts=(0.05, 0.2)),
    ),
    function=signal_filter(dead_band),
    form="y = signal - clip(signal, -half_width, half_width)",
    source="Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996)",
)
