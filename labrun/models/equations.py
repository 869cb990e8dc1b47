"""Models with equations in a TOML file, or as functions of Python."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import equations, generated, native, needed
from labrun.effects import FORCED, Site
from labrun.errors import ModelError
from labrun.models.model import Input, Model, Output, Parameter
from labrun.models.reading import (
    SITE_QUANTITIES,
    Expressions,
    conditions_of,
    initial_of,
    inputs_of,
    meanings_of,
    only_in_loads,
    parameter_of,
    places_of,
    read_effects,
    refuse_unused,
)
from labrun.models.tables import EquationsFile, ModelFile, SiteTable
from labrun.toml import Expression, ExpressionError, KeyPath, suggest


def equations_model(file: ModelFile) -> Model:
    """Return the model of a file with equations.

    Raises ModelError: all that does not hold, each with file, line, key, and for an equation the place in it.
    """
    given = file.read(EquationsFile)
    inputs = inputs_of(given.inputs)
    outputs = tuple(
        Output(name, output.unit, shows=output.equation.text) for name, output in given.outputs.items()
    )
    parameters = tuple(
        parameter_of(name, parameter, parameter.value) for name, parameter in given.parameters.items()
    )
    sites = tuple(_site(name, site) for name, site in given.sites.items())
    places = places_of(file, given.states, inputs, parameters)
    for name in given.where.keys() & {*places, *(given.conditions or {})}:
        file.note(("where", name), f"{name!r} is already the name of something else")
    initial = initial_of(file, given.initial, given.states, outputs)
    _check_states(file, given)

    readings: dict[KeyPath, Expression] = {
        ("outputs", name): output.equation for name, output in given.outputs.items()
    }
    quantities: dict[KeyPath, Expression] = {
        ("sites", name, quantity): getattr(site, quantity)
        for name, site in given.sites.items()
        for quantity in SITE_QUANTITIES
    }
    expressions: dict[KeyPath, Expression] = {
        ("where", key): expression for key, expression in given.where.items()
    }
    expressions |= {("equations", key): equation for key, equation in given.equations.items()}
    expressions |= {**readings, **quantities}
    _check_helpers(file, given.where, expressions)
    _check_springs(file, given)
    _check_forces(file, expressions, sites)
    conditions = conditions_of(file, expressions, [*places, *given.where], given.conditions)
    file.refuse()
    refuse_unused(file, expressions, parameters, conditions)
    moving = needed(given.where, [*given.equations.values(), *readings.values()])
    idle = {("where", name) for name in given.where if name not in moving}
    notes = only_in_loads(
        {path: expression for path, expression in expressions.items() if path not in idle}, parameters
    )

    places |= {condition: f"p[{len(parameters) + index}]" for index, condition in enumerate(conditions)}
    places |= {f"force.{site.name}": f"force[{index}]" for index, site in enumerate(sites)}
    written = {
        "derivative": [given.equations[state] for state in given.states],
        "output": list(readings.values()),
        "site_values": list(quantities.values()),
    }
    functions = generated(
        {name: equations(name, those, places, given.where) for name, those in written.items()}
    )
    model = Model(
        name=given.name,
        states=given.states,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        conditions=conditions,
        sites=sites,
        initial=initial,
        derivative=functions["derivative"],
        output=functions["output"],
        site_values=functions["site_values"],
        meanings=meanings_of(given.conditions),
        source=file.name,
        notes=(*_unused_inputs(expressions, inputs), *notes),
    )
    return dataclasses.replace(model, effects=read_effects(file, given.effects, model))


def _site(name: str, table: SiteTable) -> Site:
    coordinate, rate, load, stiffness = (table.text(quantity) for quantity in SITE_QUANTITIES)
    return Site(name, table.kind, coordinate, rate, load, stiffness, table.drive, table.unit)


def _check_states(file: ModelFile, given: EquationsFile) -> None:
    for state in given.equations:
        if state not in given.states:
            file.note(("equations", state), f"unknown state {state!r}", suggest(state, given.states))
    for state in given.states:
        if state not in given.equations:
            hint = f'{state} = "..." gives its time derivative'
            file.note(("equations",), f"state {state!r} has no equation", hint)


def _check_helpers(file: ModelFile, helpers: Mapping[str, Expression], written: Expressions) -> None:
    """Note a named expression that knows itself or one below it, or that nothing uses."""
    used = needed(helpers, [expression for path, expression in written.items() if path[0] != "where"])
    names = list(helpers)
    for index, (name, helper) in enumerate(helpers.items()):
        if name not in used:
            file.note(("where", name), f"no equation uses {name!r}", "take it out")
        for later in names[index:]:
            if later in helper.names:
                reason = f"{later!r} is not known here: a line knows those above it"
                problem = ExpressionError(helper.text, reason, helper.names[later])
                file.note_in(("where", name), problem)


def _check_springs(file: ModelFile, given: EquationsFile) -> None:
    for name, site in given.sites.items():
        spring = site.text("stiffness")
        # a name alone is meant to be a parameter; what else there may be in an expression is looked at where it is read
        if spring.isidentifier() and spring not in given.parameters:
            hint = suggest(spring, given.parameters)
            file.note(("sites", name, "stiffness"), f"unknown parameter {spring!r}", hint)


def _check_forces(file: ModelFile, expressions: Expressions, sites: Sequence[Site]) -> None:
    """Note a ``force.<site>`` without its site, or where a site itself is described; and a site without its force."""
    names = [site.name for site in sites]
    used: set[str] = set()
    for path, expression in expressions.items():
        for name, position in expression.names.items():
            site = name.removeprefix("force.")
            if site == name:
                continue
            used.add(site)
            if site not in names:
                hint = suggest(site, names) if names else f"declare [sites.{site}]"
                reason = f"unknown site {site!r}"
                file.note_in(path, ExpressionError(expression.text, reason, position, hint))
            elif path[0] in ("sites", "where"):
                what = (
                    "a site cannot be described"
                    if path[0] == "sites"
                    else "what equations share cannot be made"
                )
                reason = f"{what} by the force at a site"
                file.note_in(path, ExpressionError(expression.text, reason, position))
    for site in names:
        if site not in used:
            hint = "add it where a generalized force at this site would act"
            file.note(("sites", site), f"no equation uses force.{site}", hint)


def _unused_inputs(expressions: Expressions, inputs: Sequence[Input]) -> tuple[str, ...]:
    """Return what to tell about inputs that nothing uses: harmless, but worth knowing."""
    used = {name for expression in expressions.values() for name in expression.names}
    return tuple(
        f"input {signal.name!r} is used by no equation" for signal in inputs if signal.name not in used
    )


def python_model(
    name: str,
    *,
    derivative: Callable[..., Any],
    output: Callable[..., Any],
    states: Sequence[str] = (),
    inputs: Sequence[Input | str] = (),
    outputs: Sequence[Output | str],
    parameters: Sequence[Parameter] = (),
    conditions: Sequence[str] = (),
    sites: Sequence[Site] = (),
    initial: Mapping[str, float | str] | None = None,
    constants: FloatArray | None = None,
    source: str = "",
) -> Model:
    """Make a model from functions.

    They are written in what numba compiles and stand at the top level of a module; `x`, `u`, `p` and `force` are
    pointers to float64 (indexing only). They are compiled when first simulated, and kept on disk beside their module.

    Parameters
    ----------
    name
        Its name.
    derivative
        ``derivative(t, x, u, p, force, dx)`` writes the derivative of every state to `dx`.
    output
        ``output(t, x, u, p, force, y)`` writes every output to `y`.
    states, inputs, outputs, parameters, conditions
        In the order of `x`, `u`, `y` and `p` (parameters, then conditions, then `constants`).
    sites
        Joint and body sites, in the order of `force`; coordinate, rate and load are expressions in the names above.
    initial
        As in `Model`; states not named are "free".
    constants
        Numbers or a flattened table the functions read from ``p[len(parameters) + len(conditions)]`` on.

    Raises
    ------
    ModelError
        A site's expression does not hold.
    """
    ins = tuple(Input(signal) if isinstance(signal, str) else signal for signal in inputs)
    outs = tuple(Output(port) if isinstance(port, str) else port for port in outputs)
    variables = {state: f"x[{index}]" for index, state in enumerate(states)}
    variables |= {port.name: f"u[{index}]" for index, port in enumerate(ins)}
    numbers = [*(parameter.name for parameter in parameters), *conditions]
    variables |= {number: f"p[{index}]" for index, number in enumerate(numbers)}
    expressions = []
    for site in sites:
        if site.kind not in FORCED:
            raise ModelError(
                f"site {site.name} of model {name}: declare joint and body sites only, not {site.kind}"
            )
        for key in SITE_QUANTITIES:
            text = getattr(site, key) or "0"
            where = f"site {site.name} of model {name}: {key} = {text!r}"
            try:
                expressions.append(Expression.of(text))
            except ExpressionError as problem:
                raise ModelError(f"{where}: {problem.reason}", hint=problem.hint) from None
            for used in expressions[-1].names:
                if used not in variables and used != "t":
                    raise ModelError(f"{where}: unknown name {used!r}", hint=suggest(used, list(variables)))
    return Model(
        name=name,
        states=tuple(states),
        inputs=ins,
        outputs=outs,
        parameters=tuple(parameters),
        conditions=tuple(conditions),
        sites=tuple(sites),
        initial={**dict.fromkeys(states, "free"), **(initial or {})},
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=generated({"sites": equations("sites", expressions, variables)})["sites"],
        constants=np.empty(0) if constants is None else np.ascontiguousarray(constants, dtype=float).ravel(),
        source=source or f"{derivative.__module__}:{derivative.__qualname__}",
    )
