"""Effects that a bench has and its model lacks."""

from collections.abc import Iterable
from typing import Any

from labrun.effects import AttachedEffect, Scale, load_effect
from labrun.errors import ModelError, PluginError, SpecError
from labrun.models import Model
from labrun_plugins.simulated.scenes.settings import HiddenEffect


def hidden_effects(wanted: Iterable[HiddenEffect], model: Model, scale: Scale) -> list[AttachedEffect]:
    """Return the effects at their sites of the model; values not given take their first start.

    Raises
    ------
    SpecError
        No such site, or no such effect for its kind of site.
    """
    return [_attached(one, model, scale) for one in wanted]


def described(effect: AttachedEffect) -> dict[str, Any]:
    """Return an effect as JSON-ready values."""
    return {"effect": effect.effect.id, "site": effect.site, "values": dict(effect.named_values)}


def _attached(wanted: HiddenEffect, model: Model, scale: Scale) -> AttachedEffect:
    places = [
        place for place in model.places if place.name == wanted.site and wanted.kind in (None, place.kind)
    ]
    if not places:
        known = ", ".join(dict.fromkeys(place.name for place in model.places))
        raise SpecError(f"rig.scene.hide: this bench has no site {wanted.site!r}", hint=f"it has {known}")
    refusals = []
    for place in places:
        try:
            effect = load_effect(wanted.effect, place.kind)
            attached = effect.attach(wanted.site, scale, **wanted.values)
            attached.check(model)
        except (PluginError, ModelError) as error:
            refusals.append(str(error))
        else:
            return attached
    raise SpecError(
        f"rig.scene.hide: {wanted.effect!r} at {wanted.site!r}: " + "; ".join(dict.fromkeys(refusals))
    )
