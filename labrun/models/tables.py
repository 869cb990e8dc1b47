"""The tables of a model file."""

import math
from collections.abc import Mapping
from typing import Any, Literal, cast, get_args

from labrun.effects import Site, SiteKind
from labrun.models.fields import Fields, is_name
from labrun.models.model import Between, Input, Output, Parameter
from labrun.toml import Expression, suggest

_PARAMETER_KEYS = ("value", "tolerance", "unit", "lower", "upper")
_INPUT_KEYS = ("unit", "between")
_OUTPUT_KEYS = ("equation", "unit")
SITE_QUANTITIES = ("coordinate", "rate", "load", "stiffness")
_SITE_KEYS = ("kind", *SITE_QUANTITIES)


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
