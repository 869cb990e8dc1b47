"""Models read: from files with equations or an MJCF file, from robots, from plugins."""

import dataclasses
from pathlib import Path

from labrun import registry
from labrun.errors import LabrunError, ModelError
from labrun.models.equations import equations_model
from labrun.models.finding import GROUP, is_robot, model_file, model_files_like, shipped_models
from labrun.models.mjcf.file import mujoco_model
from labrun.models.mjcf.model import AT_REST, MujocoModel
from labrun.models.mjcf.robot import read_robot
from labrun.models.mjcf.robot_table import robot_table
from labrun.models.model import Model, Origin
from labrun.models.reading import initial_of, read_effects
from labrun.models.tables import BasedFile, ModelFile
from labrun.toml import suggest

_PYTHON = "name the model in it, where Python finds the file: --model {}:MODEL, or a function that makes one"
_DEEPEST = 16
"""Files that refer to files: more is a circle."""


def load_model(source: str | Path, depth: int = 0) -> Model:
    """Return a model.

    Parameters
    ----------
    source
        A ``.toml`` file, an MJCF or URDF file (see `read_robot`), the name of a model that ships with labrun or that a
        plugin brings (entry point of group ``labrun.models``), or ``"package.module:object"``; the object is a
        `Model`, or a function that returns one.
    depth
        How many files have referred to this one as their base.

    Raises
    ------
    ModelError
        The file is not there or does not hold.
    PluginError
        The plugin does not import.
    """
    path = model_file(source)
    if path is not None and path.suffix == ".py":
        path = None
    if path is not None and is_robot(path):
        robot = read_robot(path)
        model = parse_model(robot_table(robot), str(path), depth)
        return dataclasses.replace(model, notes=(*robot.remarks, *model.notes))
    if path is not None:
        return parse_model(_text(path), str(path), depth)
    name = str(source)
    if ":" in name or registry.is_installed(GROUP, name):
        loaded = registry.load(GROUP, name)
        made = loaded() if callable(loaded) and not isinstance(loaded, Model) else loaded
        if not isinstance(made, Model):
            raise ModelError(f"{name} is not a labrun model but {type(made).__name__}")
        return made
    if name.endswith(".py"):
        raise ModelError(
            f"a file of Python such as {name} holds many things", hint=_PYTHON.format(Path(name).stem)
        )
    known = [*shipped_models(), *registry.names(GROUP)]
    files = model_files_like(Path(name))
    raise ModelError(f"unknown model {name!r}", hint=suggest(name, files or known))


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
    file = ModelFile(name, text)
    model = _based_model(file, depth) if "base" in file.data else _own_model(file)
    return dataclasses.replace(model, origin=_origin(file)) if "corrected" in file.data else model


def _own_model(file: ModelFile) -> Model:
    """Return the model of a file that refers to no other."""
    return mujoco_model(file) if "mujoco" in file.data else equations_model(file)


def _origin(file: ModelFile) -> Origin:
    """Return the origin of a corrected model; paths are relative to its folder."""
    table, folder = file.data["corrected"], Path(file.name).parent
    named = (table["from"], table.get("by", ""))
    return Origin(*(str(folder / name) if name and (folder / name).exists() else name for name in named))


def _based_model(file: ModelFile, depth: int) -> Model:
    """Return the model a file makes of its base: what `load_model` takes, a path counted from the file's own folder."""
    given = file.read(BasedFile)
    if depth >= _DEEPEST:
        file.fail(("base",), f"models refer to one another more than {_DEEPEST} deep", "is it a circle?")
    sibling = Path(file.name).parent / given.base
    is_file = given.base.endswith(".toml") or sibling.is_file()
    try:
        model = load_model(sibling if is_file else given.base, depth + 1)
    except LabrunError as error:
        file.fail(("base",), str(error.args[0]), error.hint)
    parameters = {parameter.name: parameter for parameter in model.parameters}
    for name, value in given.values.items():
        parameter = parameters.get(name)
        if parameter is None:
            hint = suggest(name, parameters)
            file.note(("values", name), f"model {model.name} has no parameter {name!r}", hint)
        elif not parameter.lower <= value <= parameter.upper:
            expected = f"expected a number from {parameter.lower:g} to {parameter.upper:g}"
            file.note(("values", name), expected, at_value=True)
    rules = {state: rule for state, rule in given.initial.items() if not _rests(model, state, rule)}
    initial_of(file, rules, model.states, model.outputs)
    file.refuse()
    model = model.with_values(given.values).with_initial(given.initial)
    return dataclasses.replace(
        model,
        name=model.name if given.name is None else given.name,
        source=file.name,
        effects=(*model.effects, *read_effects(file, given.effects, model)),
    )


def _rests(model: Model, state: str, rule: float | str) -> bool:
    return isinstance(model, MujocoModel) and rule == AT_REST and state in model.guesses


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        like = model_files_like(path)
        hint = suggest(str(path), like) if like else f"looked from {Path.cwd()}"
        raise ModelError(f"cannot find the model file {path}", hint=hint) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path} cannot be read: {error}") from None
