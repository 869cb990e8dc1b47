"""Models as TOML files: parameters, equations, outputs, sites and initial state."""

import dataclasses
import tomllib

from labrun.compiled import equations, generated
from labrun.errors import ModelError
from labrun.models.attaching import read_effects
from labrun.models.based import based_model
from labrun.models.fields import Fields
from labrun.models.model import Model
from labrun.models.names import (
    check_forces,
    conditions_of,
    only_in_loads,
    places_of,
    refuse_unused,
    unused_inputs,
)
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
    "effects",
)  # fmt: skip


def parse_model(text: str, name: str, depth: int = 0) -> Model:
    """Make a model from the text of a TOML file.

    Parameters
    ----------
    text
        See the example in docs or ``experiments/models/hinge-pendulum.toml``.
    name
        What the file is called in messages; a path in the text is counted from its folder.
    depth
        How many files have referred to this one as their base.

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
    if "base" in data:
        return based_model(fields, depth)
    if "mujoco" in data:
        from labrun.models.mjcf.file import mujoco_model

        return mujoco_model(fields)
    for key in data:
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
