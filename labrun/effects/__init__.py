"""Physics a model may lack, each attachable to a site of any model."""

from labrun.effects.effect import AttachedEffect, Effect, EffectParameter, force_law, signal_filter
from labrun.effects.library import effects, load_effect
from labrun.effects.quantities import Quantity, Scale

__all__ = [
    "AttachedEffect",
    "Effect",
    "EffectParameter",
    "Quantity",
    "Scale",
    "effects",
    "force_law",
    "load_effect",
    "signal_filter",
]
