"""A channel in which a share of another one shows."""

from labrun.effects.effect import Effect, EffectParameter, signal_filter
from labrun.effects.signals import cross_talk

EFFECT = Effect(
    id="cross-talk",
    kind="output",
    parameters=(EffectParameter("share", "ratio", neutral=0.0, lower=-0.5, upper=0.5, starts=(0.05, -0.05)),),
    function=signal_filter(cross_talk),
    signals=2,
    form="y = signal + share (the model's next other output)",
    source="cross-axis sensitivity: an off-diagonal entry of a multi-axis sensor's calibration matrix",
)
