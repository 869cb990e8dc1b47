"""Which names the equations of a model file use, and which they should."""

from collections.abc import Mapping, Sequence

from labrun.effects import Site
from labrun.models.fields import Fields
from labrun.models.model import Input, Parameter
from labrun.toml import Expression, ExpressionError, KeyPath, suggest


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
