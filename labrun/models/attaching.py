"""The array of tables ``[[effects]]`` of a model file: physics that a model carries with it."""

import math
from collections.abc import Mapping
from typing import Any

from labrun.effects import AttachedEffect, Effect, EffectParameter, SiteKind, load_effect
from labrun.errors import ModelError, PluginError
from labrun.models.fields import Fields
from labrun.models.model import Model
from labrun.toml import KeyPath, suggest

_KEYS = ("effect", "site", "kind", "values")
_KINDS = ("joint", "body", "input", "output")


def read_effects(fields: Fields, model: Model) -> tuple[AttachedEffect, ...]:
    """Return the effects a file puts at sites of its model, in its order.

    Raises
    ------
    ModelError
        Unknown effect, site or value; a site that lacks what the effect needs; a value that is missing, no number or
        out of range; with the line it stands on.
    """
    tables = fields.data.get("effects", [])
    if not isinstance(tables, list) or not all(isinstance(one, dict) for one in tables):
        raise fields.text.error(
            "effects", "tables were expected", "begin each effect with a line [[effects]]"
        )
    return tuple(_attached(fields, ("effects", index), one, model) for index, one in enumerate(tables))


def _attached(fields: Fields, path: KeyPath, entry: Mapping[str, Any], model: Model) -> AttachedEffect:
    fields.check_keys(path, entry, _KEYS)
    for key in ("effect", "site"):
        if key not in entry:
            raise fields.text.error(path, f"it names no {key}", 'effect = "coulomb-friction", site = "hinge"')
    name = fields.string((*path, "effect"), entry["effect"])
    site = fields.string((*path, "site"), entry["site"])
    kind = entry.get("kind")
    if kind is not None and kind not in _KINDS:
        hint = suggest(str(kind), _KINDS)
        raise fields.text.error((*path, "kind"), f"{kind!r} is no kind of site", hint)
    effect = _effect(fields, path, name, _kinds(fields, path, model, site, kind))
    attached = effect.attach(site, **_values(fields, path, effect, entry.get("values", {})))
    try:
        attached.check(model)
    except ModelError as error:
        raise fields.text.error(path, str(error.args[0]), error.hint) from None
    return attached


def _kinds(fields: Fields, path: KeyPath, model: Model, site: str, kind: SiteKind | None) -> list[SiteKind]:
    """Return the kinds of the sites of that name, or the one that is asked for."""
    kinds = [place.kind for place in model.places if place.name == site and kind in (None, place.kind)]
    if kinds:
        return kinds
    known = {place.name for place in model.places if kind in (None, place.kind)}
    what = f"{kind} site" if kind else "site"
    hint = suggest(site, known) if known else f"it has no {what} at all"
    raise fields.text.error((*path, "site"), f"model {model.name} has no {what} {site!r}", hint)


def _effect(fields: Fields, path: KeyPath, name: str, kinds: list[SiteKind]) -> Effect:
    """Return the one effect of that name that sits at one of the kinds of sites."""
    fitting, refusals = [], []
    for kind in dict.fromkeys(kinds):
        try:
            fitting.append(load_effect(name, kind))
        except ModelError as error:  # there is none for that kind
            refusals.append(error)
        except PluginError as error:
            raise fields.text.error((*path, "effect"), str(error.args[0]), error.hint) from None
    if not fitting:
        raise fields.text.error((*path, "effect"), str(refusals[0].args[0]), refusals[0].hint)
    if len(fitting) > 1:
        both = " and ".join(one.kind for one in fitting)
        hint = f'say kind = "{fitting[0].kind}" or kind = "{fitting[1].kind}"'
        raise fields.text.error(path, f"{name} sits at {both} sites, and both have this name", hint)
    return fitting[0]


def _values(fields: Fields, path: KeyPath, effect: Effect, table: Any) -> dict[str, float]:
    path = (*path, "values")
    fields.check_keys(path, table, tuple(one.name for one in effect.parameters))
    values = {name: fields.number((*path, name), value) for name, value in table.items()}
    for parameter in effect.parameters:
        if parameter.name in values:
            _check_range(fields, (*path, parameter.name), parameter, values[parameter.name])
        elif not parameter.held:
            raise fields.text.error(
                path, f"{effect.id} needs a value of {parameter.name}", f"it is {effect.form}"
            )
    return values


def _check_range(fields: Fields, path: KeyPath, parameter: EffectParameter, value: float) -> None:
    """Refuse what is impossible at any site: a bound of 0 holds whatever the site's typical magnitudes are."""
    if value == parameter.neutral:
        return
    if math.isinf(value):
        raise fields.text.error(path, "a finite number was expected")
    for bound, sign in ((parameter.lower, 1.0), (parameter.upper, -1.0)):
        if sign * bound == 0.0 and sign * value < 0.0:
            what = "0 or more" if sign > 0 else "0 or less"
        elif sign * bound > 0.0 and sign * value <= 0.0:
            what = "a number above 0" if sign > 0 else "a number below 0"
        else:
            continue
        raise fields.text.error(path, f"{what} was expected, not {value:g}")
