"""A model file that refers to another model: ``base``, with other values and with effects."""

import dataclasses
from pathlib import Path

from labrun.errors import LabrunError
from labrun.models.attaching import read_effects
from labrun.models.fields import Fields
from labrun.models.model import Model
from labrun.toml import suggest

KEYS = ("name", "title", "base", "values", "effects")
_DEEPEST = 16
"""Files that refer to files: more is a circle."""


def based_model(fields: Fields, depth: int = 0) -> Model:
    """Return the model a file makes of its base.

    Parameters
    ----------
    fields
        The file: `base` is what `labrun.models.load_model` takes, a path counted from the file's own folder.
    depth
        How many files have referred to this one.

    Raises
    ------
    ModelError
        The base cannot be loaded, or values or effects do not fit it; with the line.
    """
    from labrun.models.loading import load_from

    for key in fields.data:
        if key not in KEYS:
            raise fields.text.unknown_key("", key, KEYS)
    base = fields.string("base", fields.data["base"])
    if depth >= _DEEPEST:
        raise fields.text.error(
            "base", f"models refer to one another more than {_DEEPEST} deep", "is it a circle?"
        )
    beside = Path(fields.text.name).parent / base
    try:
        model = load_from(beside if base.endswith(".toml") or beside.is_file() else base, depth + 1)
    except LabrunError as error:
        raise fields.text.error("base", str(error.args[0]), error.hint) from None
    model = model.with_values(_values(fields, model))
    return dataclasses.replace(
        model,
        name=fields.string("name", fields.data.get("name", model.name)),
        source=fields.text.name,
        effects=(*model.effects, *read_effects(fields, model)),
    )


def _values(fields: Fields, model: Model) -> dict[str, float]:
    parameters = {one.name: one for one in model.parameters}
    values = {}
    for name, given in fields.table("values").items():
        key = f"values.{name}"
        if name not in parameters:
            raise fields.text.error(
                key, f"model {model.name} has no parameter {name!r}", suggest(name, list(parameters))
            )
        value, lower, upper = fields.number(key, given), parameters[name].lower, parameters[name].upper
        if not lower <= value <= upper or value in (float("inf"), float("-inf")):
            raise fields.text.error(key, f"a number from {lower:g} to {upper:g} was expected, not {value:g}")
        values[name] = value
    return values
