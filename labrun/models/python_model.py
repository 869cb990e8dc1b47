"""Models whose equations are Python functions of a plugin."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import equations, generated, native
from labrun.effects import FORCED, Site
from labrun.errors import ModelError
from labrun.models.model import Input, Model, Output, Parameter
from labrun.models.toml_model import SITE_QUANTITIES
from labrun.toml import Expression, ExpressionError, suggest


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
    ins = tuple(Input(one) if isinstance(one, str) else one for one in inputs)
    outs = tuple(Output(one) if isinstance(one, str) else one for one in outputs)
    variables = {one: f"x[{index}]" for index, one in enumerate(states)}
    variables.update({one.name: f"u[{index}]" for index, one in enumerate(ins)})
    numbers = [*(one.name for one in parameters), *conditions]
    variables.update({one: f"p[{index}]" for index, one in enumerate(numbers)})
    expressions = []
    for site in sites:
        if site.kind not in FORCED:
            raise ModelError(
                f"site {site.name} of model {name}: declare joint and body sites only, not {site.kind}"
            )
        for key in SITE_QUANTITIES:
            text = getattr(site, key) or "0"
            try:
                expression = Expression.of(text)
            except ExpressionError as problem:
                raise ModelError(
                    f"site {site.name} of model {name}: {key} = {text!r}: {problem.reason}", hint=problem.hint
                ) from None
            for used in expression.names:
                if used not in variables and used != "t":
                    raise ModelError(
                        f"site {site.name} of model {name}: {key} = {text!r}: there is no {used!r}",
                        hint=suggest(used, list(variables)),
                    )
            expressions.append(expression)
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
        site_values=generated({"site_values": equations("site_values", expressions, variables)})[
            "site_values"
        ],
        constants=np.empty(0) if constants is None else np.ascontiguousarray(constants, dtype=float).ravel(),
        source=source or f"{derivative.__module__}:{derivative.__qualname__}",
    )
