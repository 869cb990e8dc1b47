"""Models as TOML files: parameters, equations, outputs, sites and initial state."""

import tomllib

from labrun.errors import ModelError
from labrun.models.fields import Fields
from labrun.models.generate import equations, generated
from labrun.models.model import Model
from labrun.models.names import check_forces, conditions_of, places_of, refuse_unused, unused_inputs
from labrun.models.problems import ModelText
from labrun.models.tables import (
    read_equations,
    read_initial,
    read_inputs,
    read_outputs,
    read_parameters,
    read_site_quantities,
    read_sites,
)

_KEYS = (
    "name", "title", "states", "inputs", "conditions", "parameters", "equations", "outputs", "sites", "initial",
)  # fmt: skip


def parse_model(text: str, name: str) -> Model:
    """Make a model from the text of a TOML file.

    Parameters
    ----------
    text
        See the example in docs or ``experiments/models/hinge-pendulum.toml``.
    name
        What the file is called in messages.

    Raises
    ------
    ModelError
        Anything that does not hold, with file, line, key, and for an equation the place in it.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ModelError(f"{name}: this is not TOML: {error}") from None
    fields = Fields(ModelText(name, text), data)
    for key in data:
        if key not in _KEYS:
            raise fields.text.unknown_key("", key, _KEYS)
    return _model(fields)


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
        notes=unused_inputs(expressions, inputs),
    )
