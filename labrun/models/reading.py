"""What all model files say alike: inputs, parameters, names, starts, conditions, and effects that a model carries."""

import math
from collections.abc import Collection, Mapping, Sequence

from labrun.effects import AttachedEffect, Effect, EffectParameter, load_effect
from labrun.errors import ModelError, PluginError
from labrun.models.model import Input, Meaning, Model, Output, Parameter
from labrun.models.tables import Bounded, ConditionTable, EffectTable, InputTable, ModelFile, is_name
from labrun.toml import Expression, ExpressionError, KeyPath, suggest

SITE_QUANTITIES = ("coordinate", "rate", "load", "stiffness")
Expressions = Mapping[KeyPath, Expression]
"""By the key that says it."""


def inputs_of(tables: Mapping[str, InputTable]) -> tuple[Input, ...]:
    """Return the inputs, in their order."""
    return tuple(Input(name, table.unit, table.between, table.prescribed) for name, table in tables.items())


def parameter_of(name: str, table: Bounded, value: float) -> Parameter:
    """Return a parameter of this value."""
    return Parameter(name, value, table.tolerance, table.unit, table.lower, table.upper)


def initial_of(
    file: ModelFile, rules: Mapping[str, float | str], states: Sequence[str], outputs: Sequence[Output]
) -> dict[str, float | str]:
    """Return where each state starts; "free" where the file does not say."""
    for state, rule in rules.items():
        path = ("initial", state)
        if state not in states:
            file.note(path, f"unknown state {state!r}", suggest(state, states))
        elif rule == "first" and state not in [output.name for output in outputs]:
            file.note(
                path,
                f'"first" is the mean of an output\'s first samples, and the model has no output {state!r}',
            )
        elif isinstance(rule, str) and rule not in ("first", "free") and not is_name(rule):
            file.note(path, 'it is neither a number, "first", "free" nor the name of a condition or an input')
    return {state: rules.get(state, "free") for state in states}


def places_of(
    file: ModelFile, states: Sequence[str], inputs: Sequence[Input], parameters: Sequence[Parameter]
) -> dict[str, str]:
    """Return the place of each name in the arguments of the generated functions; no name may stand for two things."""
    places: dict[str, str] = {}
    kinds: dict[str, str] = {}
    groups = {
        "state": ("x", list(states)),
        "input": ("u", [signal.name for signal in inputs]),
        "parameter": ("p", [parameter.name for parameter in parameters]),
    }
    for kind, (array, names) in groups.items():
        for index, name in enumerate(names):
            if name in places:
                file.note((f"{kind}s", name), f"{name!r} is already the name of a {kinds[name]}")
            places[name], kinds[name] = f"{array}[{index}]", kind
    return places


def conditions_of(
    file: ModelFile, expressions: Expressions, known: Collection[str], declared: Collection[str] | None
) -> tuple[str, ...]:
    """Return the names that are no state, input or parameter, in the order they are met.

    Where the file declares its conditions, a name that is none of them is a fault.
    """
    names: dict[str, None] = {}
    for path, expression in expressions.items():
        for name, position in expression.names.items():
            if name.startswith("force.") or name in known or name == "t":
                continue
            if declared is not None and name not in declared:
                hint = suggest(name, [*known, *declared])
                file.note_in(path, ExpressionError(expression.text, f"unknown name {name!r}", position, hint))
            names.setdefault(name)
    return tuple(names)


def meanings_of(tables: Mapping[str, ConditionTable] | None) -> dict[str, Meaning]:
    """Return what conditions mean that trials may say in a word, or not at all."""
    return {name: Meaning(table.words, table.default, table.of) for name, table in (tables or {}).items()}


def refuse_unused(
    file: ModelFile, expressions: Expressions, parameters: Sequence[Parameter], conditions: Sequence[str]
) -> None:
    """Refuse parameters that nothing uses: mostly a misspelt name, and never something data could determine."""
    used = {name for expression in expressions.values() for name in expression.names}
    misspelt = f"equations use {', '.join(conditions)}, which is not a parameter; check the spelling"
    for parameter in parameters:
        if parameter.name not in used:
            hint = misspelt if conditions else "take it out"
            file.note(("parameters", parameter.name), f"no equation uses {parameter.name!r}", hint)
    file.refuse()


def only_in_loads(expressions: Expressions, parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """Return what to tell about parameters that only loads of sites use: without an effect they change nothing."""
    moving = {
        name for path, expression in expressions.items() if path[0] != "sites" for name in expression.names
    }
    return tuple(
        f"parameter {parameter.name!r} is used by the load of a site only: no data tell its value "
        "without an effect there"
        for parameter in parameters
        if parameter.name not in moving
    )


def read_effects(file: ModelFile, tables: Sequence[EffectTable], model: Model) -> tuple[AttachedEffect, ...]:
    """Return the effects a file puts at sites of its model, in its order.

    Raises ModelError: all that does not hold: an unknown effect, site or value; a site that lacks what the effect
    needs; a value that is missing or out of range; each with the line it stands on.
    """
    effects = [_attached(file, ("effects", index), table, model) for index, table in enumerate(tables)]
    file.refuse()
    return tuple(effect for effect in effects if effect is not None)


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
        model.site_named(table.site, table.kind)
    except ModelError as error:
        file.note((*path, "site"), str(error.args[0]), error.hint)
        return None
    there = [location for location in model.places if location.name == table.site]
    kinds = dict.fromkeys(location.kind for location in there if table.kind in (None, location.kind))
    fitting: list[Effect] = []
    refusal: ModelError | PluginError | None = None
    for kind in kinds:
        try:
            fitting.append(load_effect(table.effect, kind))
        except (ModelError, PluginError) as error:  # there is none for that kind, or none at all
            refusal = refusal or error
    if len(fitting) > 1:
        both = " and ".join(effect.kind for effect in fitting)
        hint = f'say kind = "{fitting[0].kind}" or kind = "{fitting[1].kind}"'
        file.note(path, f"{table.effect} sits at {both} sites, and both have this name", hint)
    elif fitting:
        return fitting[0]
    elif refusal is not None:
        file.note((*path, "effect"), str(refusal.args[0]), refusal.hint)
    return None


def _values_hold(file: ModelFile, path: KeyPath, effect: Effect, table: EffectTable) -> bool:
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    strangers = [name for name in table.values if name not in parameters]
    for name in strangers:
        file.note((*path, name), "unknown key", suggest(name, parameters))
    missing = [
        parameter.name
        for parameter in effect.parameters
        if not (parameter.held or parameter.name in table.values)
    ]
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
    """Return what is expected of an impossible value; "" if it is possible.

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
