"""The sign function of dry friction, smoothed: the speed below which friction fades to zero."""

from labrun.effects.effect import EffectParameter

TRANSITION_SPEED = EffectParameter(
    "transition_speed",
    "rate",
    neutral=None,
    lower=3e-3,  # sharper than an integrator's steps resolve
    upper=0.1,
    starts=(0.01, 0.05, 0.004),
    held=True,
)
"""Of ``tanh(rate / transition_speed)``: a hundredth of the peak speed, unless the data ask for another shape."""
