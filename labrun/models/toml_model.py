"""Models whose equations stand in a TOML file: parameters, equations, outputs, sites and initial state."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast, get_args

from labrun.compiled import equations, generated
from labrun.effects import Site, SiteKind
from labrun.models.attaching import read_effects
from labrun.models.fields import Fields, is_name
from labrun.models.model import Between, Input, Model, Output, Parameter
from labrun.toml import Expression, ExpressionError, KeyPath, suggest

_KEYS = (
    "name", "title", "states", "inputs", "conditions", "parameters", "equations", "outputs", "sites", "initial",
    "effects",
)  # fmt: skip
_PARAMETER_KEYS = ("value", "tolerance", "unit", "lower", "upper")
_INPUT_KEYS = ("unit", "between")
_OUTPUT_KEYS = ("equation", "unit")
SITE_QUANTITIES = ("coordinate", "rate", "load", "stiffness")
_SITE_KEYS = ("kind", *SITE_QUANTITIES)


def equations_model(fields: Fields) -> Model:
    """Return the model of a file with equations.

    Raises
    ------
    ModelError
        Anything that does not hold, with file, line, key, and for an equation the place in it.
    """
    for key in fields.data:
        if key not in _KEYS:
            raise fields.text.unknown_key("", key, _KEYS)
    model = _model(fields)
    return dataclasses.replace(model, effects=read_effects(fields, model))


def _model(fields: Fields) -> Model:
    name = fields.data.get("name")
    if not isinstance(name, str) or not name:
        raise fields.text.error("name", 'a model needs a name = "..."')
    states = fields.names("states")
    inputs = read_inputs(fields)
    parameters = read_parameters(fields)
    places = places_of(fields, states, inputs, parameters)
    sites = read_sites(fields, places)
    derivatives = read_equations(fields, states)
    outputs, readings = read_outputs(fields)
    quantities = read_site_quantities(fields, sites)

    expressions = {f"equations.{state}": one for state, one in zip(states, derivatives, strict=True)}
    expressions |= {f"outputs.{output.name}": one for output, one in zip(outputs, readings, strict=True)}
    expressions |= quantities
    check_forces(fields, expressions, sites)
    declared = fields.names("conditions") if "conditions" in fields.data else None
    conditions = conditions_of(fields, expressions, places, declared)
    refuse_unused(fields, expressions, parameters, conditions)

    places |= {one: f"p[{len(parameters) + index}]" for index, one in enumerate(conditions)}
    places |= {f"force.{site.name}": f"force[{index}]" for index, site in enumerate(sites)}
    functions = generated(
        {
            "derivative": equations("derivative", derivatives, places),
            "output": equations("output", readings, places),
            "site_values": equations("site_values", list(quantities.values()), places),
        }
    )
    return Model(
        name=name,
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        conditions=conditions,
        sites=sites,
        initial=read_initial(fields, states, outputs),
        derivative=functions["derivative"],
        output=functions["output"],
        site_values=functions["site_values"],
        source=fields.text.name,
        notes=(*unused_inputs(expressions, inputs), *only_in_loads(expressions, parameters)),
    )


def read_inputs(fields: Fields) -> tuple[Input, ...]:
    """Read a list of names, or a table of inputs with unit and `between`."""
    table = fields.data.get("inputs", [])
    if not isinstance(table, dict):
        return tuple(Input(name) for name in fields.names("inputs"))
    inputs = []
    for name, entry in table.items():
        key = f"inputs.{name}"
        fields.check_name(key, name)
        fields.check_keys(key, entry, _INPUT_KEYS)
        between = entry.get("between", "linear")
        if between not in get_args(Between):
            raise fields.text.error(
                f"{key}.between",
                f"{between!r} is not a way to run between samples",
                "linear, hold or band-limited",
            )
        inputs.append(
            Input(name, fields.string(f"{key}.unit", entry.get("unit", "1")), cast("Between", between))
        )
    return tuple(inputs)


def read_parameters(fields: Fields) -> tuple[Parameter, ...]:
    """Read the parameters, in their order."""
    parameters = []
    for name, given in fields.table("parameters").items():
        key = f"parameters.{name}"
        fields.check_name(key, name)
        entry = {"value": given} if isinstance(given, int | float) and not isinstance(given, bool) else given
        fields.check_keys(key, entry, _PARAMETER_KEYS)
        if "value" not in entry:
            raise fields.text.error(
                key, "it has no value", f'{name} = {{ value = 1.0, tolerance = 0.1, unit = "kg" }}'
            )
        value = fields.number(f"{key}.value", entry["value"])
        if math.isinf(value):
            raise fields.text.error(f"{key}.value", "the value is infinite")
        lower = fields.number(f"{key}.lower", entry.get("lower", -math.inf))
        upper = fields.number(f"{key}.upper", entry.get("upper", math.inf))
        if not lower <= value <= upper:
            raise fields.text.error(
                key, f"the value {value:g} is outside of its bounds {lower:g} to {upper:g}"
            )
        unit = fields.string(f"{key}.unit", entry.get("unit", "1"))
        parameters.append(Parameter(name, value, _tolerance(fields, key, entry), unit, lower, upper))
    return tuple(parameters)


def _tolerance(fields: Fields, key: str, entry: Mapping[str, Any]) -> "float | Literal['free']":
    tolerance = entry.get("tolerance", "free")
    if tolerance == "free":
        return "free"
    if isinstance(tolerance, str):
        raise fields.text.error(f"{key}.tolerance", f'{tolerance!r} is neither a number nor "free"')
    number = fields.number(f"{key}.tolerance", tolerance)
    if not 0 <= number < math.inf:
        raise fields.text.error(
            f"{key}.tolerance",
            f"a relative standard deviation is 0 or more, not {number:g}",
            '"free" = not known',
        )
    return number


def read_equations(fields: Fields, states: tuple[str, ...]) -> list[Expression]:
    """Read the derivative of every state, in the order of the states."""
    table = fields.table("equations")
    for key in table:
        if key not in states:
            raise fields.text.error(f"equations.{key}", f"there is no state {key!r}", suggest(key, states))
    for state in states:
        if state not in table:
            raise fields.text.error(
                "equations",
                f"state {state!r} has no equation",
                f'{state} = "..." gives its time derivative',
            )
    return [fields.expression(f"equations.{state}", table[state]) for state in states]


def read_outputs(fields: Fields) -> tuple[tuple[Output, ...], list[Expression]]:
    """Read the outputs and their equations."""
    table = fields.table("outputs")
    if not table:
        raise fields.text.error(
            "outputs", "a model needs at least one output", '[outputs]\n  angle = "angle"'
        )
    outputs, expressions = [], []
    for name, given in table.items():
        key = f"outputs.{name}"
        entry = given if isinstance(given, dict) else {"equation": given}
        fields.check_keys(key, entry, _OUTPUT_KEYS)
        if "equation" not in entry:
            raise fields.text.error(key, "it has no equation")
        outputs.append(Output(name, fields.string(f"{key}.unit", entry.get("unit", "1"))))
        expressions.append(fields.expression(key, entry["equation"]))
    return tuple(outputs), expressions


def read_sites(fields: Fields, known: Mapping[str, str]) -> tuple[Site, ...]:
    """Read the joint and body sites; `known` tells which names are parameters."""
    sites = []
    for name, entry in fields.table("sites").items():
        key = f"sites.{name}"
        if not is_name(name):
            raise fields.text.error(key, f"{name!r} cannot be used in equations as force.{name}")
        fields.check_keys(key, entry, _SITE_KEYS)
        kind = entry.get("kind")
        if kind in ("input", "output"):
            raise fields.text.error(
                f"{key}.kind", f"every {kind} is a site already", "declare joint and body sites only"
            )
        if kind not in ("joint", "body"):
            raise fields.text.error(f"{key}.kind", f"a site is a joint or a body, not {kind!r}")
        for needed in ("coordinate", "rate"):
            if needed not in entry:
                raise fields.text.error(key, f"a {kind} site needs a {needed}", f'{needed} = "angle"')
        texts = {one: fields.string(f"{key}.{one}", entry.get(one, "")) for one in SITE_QUANTITIES}
        stiffness = texts["stiffness"]
        # a name alone is meant to be a parameter; what else there may be in an expression is looked at where it is read
        if stiffness.isidentifier() and not known.get(stiffness, "").startswith("p["):
            parameters = [one for one, place in known.items() if place.startswith("p[")]
            raise fields.text.error(
                f"{key}.stiffness", f"there is no parameter {stiffness!r}", suggest(stiffness, parameters)
            )
        sites.append(Site(name, cast("SiteKind", kind), **texts))
    return tuple(sites)


def read_site_quantities(fields: Fields, sites: tuple[Site, ...]) -> dict[str, Expression]:
    """Read coordinate, rate, load and stiffness of each site, by their keys; 0 where it has none."""
    return {
        f"sites.{site.name}.{quantity}": fields.expression(
            f"sites.{site.name}.{quantity}", getattr(site, quantity) or "0"
        )
        for site in sites
        for quantity in SITE_QUANTITIES
    }


def read_initial(
    fields: Fields, states: tuple[str, ...], outputs: tuple[Output, ...]
) -> dict[str, float | str]:
    """Read where each state starts; "free" where the file does not say."""
    table = fields.table("initial")
    for key in table:
        if key not in states:
            raise fields.text.error(f"initial.{key}", f"there is no state {key!r}", suggest(key, states))
    result: dict[str, float | str] = {}
    for state in states:
        key, rule = f"initial.{state}", table.get(state, "free")
        if not isinstance(rule, str):
            result[state] = fields.number(key, rule)
            continue
        if rule == "first" and state not in [output.name for output in outputs]:
            raise fields.text.error(
                key,
                f'"first" is the mean of an output\'s first samples, and there is no output {state!r}',
            )
        if rule not in ("first", "free") and not is_name(rule):
            raise fields.text.error(
                key, f'{rule!r} is neither a number, "first", "free" nor the name of a condition'
            )
        result[state] = rule
    return result


def places_of(
    fields: Fields, states: Sequence[str], inputs: Sequence[Input], parameters: Sequence[Parameter]
) -> dict[str, str]:
    """Return the place of each name in the arguments of the generated functions; no name may stand for two things."""
    places: dict[str, str] = {}
    kinds: dict[str, str] = {}
    groups = {
        "state": ("x", list(states)),
        "input": ("u", [one.name for one in inputs]),
        "parameter": ("p", [one.name for one in parameters]),
    }
    for kind, (array, names) in groups.items():
        for index, name in enumerate(names):
            if name in places:
                raise fields.text.error(f"{kind}s", f"{name!r} is already the name of a {kinds[name]}")
            places[name], kinds[name] = f"{array}[{index}]", kind
    return places


def conditions_of(
    fields: Fields,
    expressions: Mapping[str, Expression] | Mapping[KeyPath, Expression],
    known: Mapping[str, str],
    declared: Sequence[str] | None,
) -> tuple[str, ...]:
    """Return the names that are no state, input or parameter, in the order they are met.

    Raises
    ------
    ModelError
        The file declares its conditions, and a name is none of them.
    """
    found: dict[str, None] = {}
    for key, expression in expressions.items():
        for name, position in expression.names.items():
            if name.startswith("force.") or name in known or name == "t":
                continue
            if declared is not None and name not in declared:
                problem = ExpressionError(
                    expression.text, f"there is no {name!r}", position, suggest(name, [*known, *declared])
                )
                raise fields.text.equation_error(key, problem)
            found.setdefault(name)
    return tuple(found)


def check_forces(fields: Fields, expressions: Mapping[str, Expression], sites: Sequence[Site]) -> None:
    """Refuse a ``force.<site>`` without its site, or where a site itself is described; and a site without its force."""
    names = [site.name for site in sites]
    used: set[str] = set()
    for key, expression in expressions.items():
        for name, position in expression.names.items():
            site = name.removeprefix("force.")
            if site == name:
                continue
            if site not in names:
                hint = suggest(site, names) if names else f"declare [sites.{site}]"
                problem = ExpressionError(expression.text, f"there is no site {site!r}", position, hint)
                raise fields.text.equation_error(key, problem)
            if key.startswith("sites."):
                reason = "a site cannot be described by the force at a site"
                problem = ExpressionError(expression.text, reason, position)
                raise fields.text.equation_error(key, problem)
            used.add(site)
    for site in names:
        if site not in used:
            hint = "add it where a generalized force at this site would act"
            raise fields.text.error(f"sites.{site}", f"no equation uses force.{site}", hint)


def refuse_unused(
    fields: Fields,
    expressions: Mapping[str, Expression] | Mapping[KeyPath, Expression],
    parameters: Sequence[Parameter],
    conditions: Sequence[str],
) -> None:
    """Refuse a parameter that nothing uses: mostly a misspelt name, and never something data could determine."""
    used = {name for one in expressions.values() for name in one.names}
    for one in parameters:
        if one.name not in used:
            others = ", ".join(conditions)
            hint = (
                f"equations use {others}, which is no parameter: misspelt?" if conditions else "take it out"
            )
            raise fields.text.error(f"parameters.{one.name}", f"no equation uses {one.name!r}", hint)


def unused_inputs(expressions: Mapping[str, Expression], inputs: Sequence[Input]) -> tuple[str, ...]:
    """Return what to tell about inputs that nothing uses: harmless, but worth knowing."""
    used = {name for one in expressions.values() for name in one.names}
    return tuple(f"input {one.name!r} is used by no equation" for one in inputs if one.name not in used)


def only_in_loads(
    expressions: Mapping[str, Expression] | Mapping[KeyPath, Expression], parameters: Sequence[Parameter]
) -> tuple[str, ...]:
    """Return what to tell about parameters that only loads of sites use: without an effect they change nothing."""
    moving = {
        name
        for key, one in expressions.items()
        if not (key.startswith("sites.") if isinstance(key, str) else key[0] == "sites")
        for name in one.names
    }
    return tuple(
        f"parameter {one.name!r} is used by the load of a site only: no data tell its value without an effect there"
        for one in parameters
        if one.name not in moving
    )
