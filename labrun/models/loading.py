"""Find a model by file, plugin name or dotted name, and read its file."""

import dataclasses
import tomllib
from pathlib import Path

from labrun import registry
from labrun.errors import LabrunError, ModelError
from labrun.models.attaching import read_effects
from labrun.models.fields import Fields, ModelText
from labrun.models.mjcf.file import mujoco_model
from labrun.models.model import Model
from labrun.models.toml_model import equations_model
from labrun.toml import suggest

_GROUP = "labrun.models"
_BASED_KEYS = ("name", "title", "base", "values", "effects")
_DEEPEST = 16
"""Files that refer to files: more is a circle."""


def load_model(source: str | Path) -> Model:
    """Return a model.

    Parameters
    ----------
    source
        A ``.toml`` file, the name of a model that ships with labrun or that a plugin brings (entry point of group
        ``labrun.models``), or ``"package.module:object"``; the object is a `Model`, or a function that returns one.

    Raises
    ------
    ModelError
        The file is not there or does not hold.
    PluginError
        The plugin does not import.
    """
    return load_from(source)


def load_from(source: str | Path, depth: int = 0) -> Model:
    """Do as `load_model`; `depth` counts the files that have referred to this one."""
    path = model_file(source)
    if path is not None:
        return parse_model(_text(path), str(path), depth)
    name = str(source)
    if ":" in name or registry.is_installed(_GROUP, name):
        found = registry.load(_GROUP, name)
        made = found() if callable(found) and not isinstance(found, Model) else found
        if not isinstance(made, Model):
            raise ModelError(f"{name} is no labrun model but {type(made).__name__}")
        return made
    known = [*shipped_models(), *registry.names(_GROUP)]
    raise ModelError(f"there is no model {name!r}", hint=suggest(name, known))


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
        return _based_model(fields, depth)
    if "mujoco" in data:
        return mujoco_model(fields)
    return equations_model(fields)


def _based_model(fields: Fields, depth: int = 0) -> Model:
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
    for key in fields.data:
        if key not in _BASED_KEYS:
            raise fields.text.unknown_key("", key, _BASED_KEYS)
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
    model = model.with_values(_other_values(fields, model))
    return dataclasses.replace(
        model,
        name=fields.string("name", fields.data.get("name", model.name)),
        source=fields.text.name,
        effects=(*model.effects, *read_effects(fields, model)),
    )


def _other_values(fields: Fields, model: Model) -> dict[str, float]:
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


def shipped_models() -> dict[str, Path]:
    """Return the model files that come with labrun, by name."""
    package = Path(__file__).parents[1]
    for folder in (package / "shipped_experiments" / "models", package.parent / "experiments" / "models"):
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    return {}


def model_file(source: str | Path) -> Path | None:
    """Return the file that `load_model` would read for a source; None where it is no file."""
    path = Path(source)
    if path.suffix == ".toml" or path.is_file():
        return path
    name = str(source)
    if ":" in name or registry.is_installed(_GROUP, name):
        return None
    return shipped_models().get(name)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ModelError(f"there is no model file {path}", hint=f"looked from {Path.cwd()}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path} cannot be read: {error}") from None
