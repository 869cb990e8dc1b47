"""Physics a model may lack, each attachable to a site of any model."""

from labrun.effects.effect import (
    FORCED,
    AttachedEffect,
    Effect,
    EffectParameter,
    Quantity,
    Scale,
    Site,
    SiteKind,
    force_law,
    signal_filter,
    unit_of,
)
from labrun.effects.reading import effects, load_effect, read_effects, shipped

__all__ = [
    "FORCED", "AttachedEffect", "Effect", "EffectParameter", "Quantity", "Scale", "Site", "SiteKind", "effects",
    "force_law", "load_effect", "read_effects", "shipped", "signal_filter", "unit_of",
]  # fmt: skip
