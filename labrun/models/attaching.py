"""The array of tables ``[[effects]]`` of a model file: physics that a model carries with it."""

import math
from collections.abc import Sequence

from labrun.effects import AttachedEffect, Effect, EffectParameter, load_effect
from labrun.errors import ModelError, PluginError
from labrun.models.model import Model
from labrun.models.tables import EffectTable, ModelFile
from labrun.toml import KeyPath, suggest


def read_effects(file: ModelFile, tables: Sequence[EffectTable], model: Model) -> tuple[AttachedEffect, ...]:
    """Return the effects a file puts at sites of its model, in its order.

    Raises
    ------
    ModelError
        All that does not hold: an unknown effect, site or value; a site that lacks what the effect needs; a value that
        is missing or out of range; each with the line it stands on.
    """
    found = [_attached(file, ("effects", index), one, model) for index, one in enumerate(tables)]
    file.refuse()
    return tuple(one for one in found if one is not None)


def _attached(file: ModelFile, path: KeyPath, table: EffectTable, model: Model) -> AttachedEffect | None:
    effect = _effect(file, path, table, model)
    if effect is None or not _values_hold(file, (*path, "values"), effect, table):
        return None
    attached = effect.attach(table.site, **table.values)
    try:
        attached.check(model)
    except ModelError as error:
        file.note(path, str(error.args[0]), error.hint)
    return attached


def _effect(file: ModelFile, path: KeyPath, table: EffectTable, model: Model) -> Effect | None:
    """Return the one effect of the table's name that sits at one of the kinds of sites of its site's name."""
    try:
        model.place(table.site, table.kind)
    except ModelError as error:
        file.note((*path, "site"), str(error.args[0]), error.hint)
        return None
    there = [place for place in model.places if place.name == table.site]
    kinds = dict.fromkeys(place.kind for place in there if table.kind in (None, place.kind))
    fitting: list[Effect] = []
    refusal: ModelError | PluginError | None = None
    for kind in kinds:
        try:
            fitting.append(load_effect(table.effect, kind))
        except (ModelError, PluginError) as error:  # there is none for that kind, or none at all
            refusal = refusal or error
    if len(fitting) > 1:
        both = " and ".join(one.kind for one in fitting)
        hint = f'say kind = "{fitting[0].kind}" or kind = "{fitting[1].kind}"'
        file.note(path, f"{table.effect} sits at {both} sites, and both have this name", hint)
    elif fitting:
        return fitting[0]
    elif refusal is not None:
        file.note((*path, "effect"), str(refusal.args[0]), refusal.hint)
    return None


def _values_hold(file: ModelFile, path: KeyPath, effect: Effect, table: EffectTable) -> bool:
    parameters = {one.name: one for one in effect.parameters}
    strangers = [name for name in table.values if name not in parameters]
    for name in strangers:
        file.note((*path, name), "unknown key", suggest(name, parameters))
    missing = [one.name for one in effect.parameters if not (one.held or one.name in table.values)]
    for name in () if strangers else missing:
        file.note(path, f"{effect.id} needs a value of {name}", f"it is {effect.form}")
    wanted = {
        name: _wanted(parameters[name], table.values[name]) for name in parameters if name in table.values
    }
    for name, what in wanted.items():
        if what:
            file.note((*path, name), f"expected {what}", at_value=True)
    return not (strangers or missing or any(wanted.values()))


def _wanted(parameter: EffectParameter, value: float) -> str:
    """Return what is expected of a value that is impossible at any site; "" of one that is not.

    A bound of 0 holds whatever the site's typical magnitudes are.
    """
    if value == parameter.neutral:
        return ""
    if not math.isfinite(value):
        return "a finite number"
    for bound, sign in ((parameter.lower, 1.0), (parameter.upper, -1.0)):
        if sign * bound == 0.0 and sign * value < 0.0:
            return "0 or more" if sign > 0 else "0 or less"
        if sign * bound > 0.0 and sign * value <= 0.0:
            return "a number above 0" if sign > 0 else "a number below 0"
    return ""
