"""Models by name: found, read, and written with corrections."""

import dataclasses
import math
import os
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import tomli_w

from labrun import registry
from labrun.effects import AttachedEffect, Effect, effects
from labrun.errors import LabrunError, ModelError
from labrun.models.chains.file import chain_model
from labrun.models.chains.model import AT_REST, ClosedChain
from labrun.models.equations import equations_model, initial_of, read_effects
from labrun.models.mjcf.file import mujoco_model
from labrun.models.mjcf.robot import is_robot, model_files_like, read_robot
from labrun.models.model import Model, Origin
from labrun.models.tables import BasedFile, ModelFile
from labrun.toml import KeyPath, locate, replaced, suggest

_GROUP = "labrun.models"
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
        model = parse_model(robot.table(), str(path), depth)
        return dataclasses.replace(model, notes=(*robot.remarks, *model.notes))
    if path is not None:
        return parse_model(_text(path), str(path), depth)
    name = str(source)
    if ":" in name or registry.is_installed(_GROUP, name):
        found = registry.load(_GROUP, name)
        made = found() if callable(found) and not isinstance(found, Model) else found
        if not isinstance(made, Model):
            raise ModelError(f"{name} is no labrun model but {type(made).__name__}")
        return made
    if name.endswith(".py"):
        raise ModelError(
            f"a file of Python such as {name} holds many things", hint=_PYTHON.format(Path(name).stem)
        )
    known = [*shipped_models(), *registry.names(_GROUP)]
    files = model_files_like(Path(name))
    raise ModelError(f"there is no model {name!r}", hint=suggest(name, files or known))


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
    if "mujoco" in file.data:
        return mujoco_model(file)
    return chain_model(file) if {"bodies", "joints", "loop"} & set(file.data) else equations_model(file)


def _origin(file: ModelFile) -> Origin:
    """Return where a corrected model says it comes from; files are counted from the folder of its own."""
    table, folder = file.data["corrected"], Path(file.name).parent
    named = (table["from"], table.get("by", ""))
    return Origin(*(str(folder / one) if one and (folder / one).exists() else one for one in named))


def _based_model(file: ModelFile, depth: int) -> Model:
    """Return the model a file makes of its base: what `load_model` takes, a path counted from the file's own folder."""
    given = file.read(BasedFile)
    if depth >= _DEEPEST:
        file.fail(("base",), f"models refer to one another more than {_DEEPEST} deep", "is it a circle?")
    beside = Path(file.name).parent / given.base
    is_file = given.base.endswith(".toml") or beside.is_file()
    try:
        model = load_model(beside if is_file else given.base, depth + 1)
    except LabrunError as error:
        file.fail(("base",), str(error.args[0]), error.hint)
    parameters = {one.name: one for one in model.parameters}
    for name, value in given.values.items():
        one = parameters.get(name)
        if one is None:
            hint = suggest(name, parameters)
            file.note(("values", name), f"model {model.name} has no parameter {name!r}", hint)
        elif not one.lower <= value <= one.upper:
            expected = f"expected a number from {one.lower:g} to {one.upper:g}"
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
    return isinstance(model, ClosedChain) and rule == AT_REST and state in model.tree.joints


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
    if path.suffix == ".toml" or is_robot(path) or path.is_file():
        return path
    name = str(source)
    if ":" in name or registry.is_installed(_GROUP, name):
        return None
    return shipped_models().get(name)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        like = model_files_like(path)
        hint = suggest(str(path), like) if like else f"looked from {Path.cwd()}"
        raise ModelError(f"there is no model file {path}", hint=hint) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path} cannot be read: {error}") from None


def corrected_model_text(
    model: Model,
    text_or_path: str | Path,
    values: Mapping[str, float],
    effects: Sequence[AttachedEffect] = (),
    remarks: str | Sequence[str] = (),
    *,
    folder: Path | None = None,
    heading: str = "Corrected by labrun",
    data: str = "",
) -> str:
    """Return a TOML file of a model with other parameter values, and with these effects behind those it carries.

    A model with equations of its own in a file is returned as that file, values replaced where they stand, everything
    else as it was. Of any other model (Python, plugin, MuJoCo) a short file refers to it as its ``base``.

    Parameters
    ----------
    model
        The model that is corrected.
    text_or_path
        Where it comes from: what `labrun.models.load_model` took, or the text of its file.
    values : parameter -> value
        In the parameters' units; those not named stay as they are.
    effects
        Physics to add.
    remarks
        Sentences for the comment on top: where the numbers come from.
    folder
        Where the text will be saved, so that it can refer to a file from there; None refers by the absolute path.
    heading
        How the comment on top begins, before "from" and the name of the file that was changed.
    data
        The run or recording that corrected it.

    Raises
    ------
    ModelError
        An unknown parameter, a value out of its bounds or not finite, an effect that does not fit its site.
    """
    changed = _changed(model, values)
    model.with_effects(effects)
    given = str(text_or_path)
    path = None if "\n" in given else model_file(text_or_path)
    text = given if "\n" in given else path.read_text(encoding="utf-8") if path is not None else ""
    table = tomllib.loads(text)
    if "base" in table:
        body = _with_values(text, changed)
        if path is not None and str(table["base"]).endswith(".toml"):
            base = _from_folder(path.parent / table["base"], folder)
            body = replaced(body, {("base",): _quoted(base)})
    elif "mujoco" in table or not text:
        named = path is None or (path.suffix == ".toml" and Path(given).suffix != ".toml")
        base = given if named or path is None else _from_folder(path, folder)
        body = _with_values(f"base = {_quoted(base)}\n", changed)
    else:
        for name in changed.keys() - table.get("parameters", {}).keys():
            raise ModelError(f"the text given for model {model.name} has no parameter {name!r}")
        body = _with_parameters(text, changed)
    origin = path.name if path is not None else given if not text else model.source or model.name
    top = _comment(model, f"{heading} from {origin}", changed, remarks)
    body = _with_effects(body, effects)
    if "\n" in given:
        return top + body
    source = given if path is None or Path(given) != path else _from_folder(path, folder)
    entry = f"{{ from = {_quoted(source)}, by = {_quoted(data and _from_folder(Path(data), folder))} }}"
    if "corrected" in table:
        return top + replaced(body, {("corrected",): entry})
    return f"{top}corrected = {entry}\n{body}"


def _from_folder(path: Path, folder: Path | None) -> str:
    """Return a path as a file in that folder would name it."""
    absolute = path.resolve()
    return str(absolute) if folder is None else os.path.relpath(absolute, folder.resolve())


def _changed(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values that differ from the model's own, checked."""
    parameters = {one.name: one for one in model.parameters}
    changed = {}
    for name, given in values.items():
        if name not in parameters:
            raise ModelError(
                f"model {model.name} has no parameter {name!r}", hint=suggest(name, list(parameters))
            )
        one, value = parameters[name], float(given)
        if not math.isfinite(value) or not one.lower <= value <= one.upper:
            raise ModelError(
                f"{name} = {value:g} cannot be written: model {model.name} takes {one.lower:g} to {one.upper:g}"
            )
        if value != one.value:
            changed[name] = value
    return changed


def _comment(model: Model, heading: str, changed: Mapping[str, float], remarks: str | Sequence[str]) -> str:
    sentences = [remarks] if isinstance(remarks, str) else list(remarks)
    lines = [heading, *sentences]
    parameters = {one.name: one for one in model.parameters}
    for name, value in changed.items():
        unit = "" if parameters[name].unit == "1" else f" {parameters[name].unit}"
        lines.append(f"{name}: {parameters[name].value:g}{unit} became {value:g}{unit}")
    return "".join(f"# {line}\n" for one in lines for line in one.splitlines()) + "\n"


def _quoted(text: str) -> str:
    """Return text as TOML writes it."""
    return tomli_w.dumps({"a": text}).removeprefix("a = ").strip()


def _with_parameters(text: str, values: Mapping[str, float]) -> str:
    """Replace parameter values of a model with equations, however it writes them."""
    found = locate(text).spans
    paths: dict[KeyPath, str] = {}
    for name, value in values.items():
        path = ("parameters", name)
        paths[(*path, "value") if (*path, "value") in found else path] = repr(value)
    return replaced(text, paths)


def _with_values(text: str, values: Mapping[str, float]) -> str:
    """Replace the values of a model with a base, and add those that are not there yet."""
    there = {("values", name) for name in values} & locate(text).spans.keys()
    text = replaced(text, {path: repr(values[str(path[-1])]) for path in there})
    new = {name: repr(value) for name, value in values.items() if ("values", name) not in there}
    if not new:
        return text
    found = locate(text)
    rows = text.splitlines()
    head = found.keys.get(("values",))
    place = None if head is None else head.line
    if ("values",) in found.spans:  # values = { ... }
        inner = [f"{name} = {value}" for name, value in new.items()]
        names = [path for path in found.spans if path[:1] == ("values",) and len(path) == 2]
        if not names:
            return replaced(text, {("values",): f"{{ {', '.join(inner)} }}"})
        last = max(names, key=lambda path: found.spans[path])
        return _behind(text, found.spans[last][1], f", {', '.join(inner)}")
    if place is None:  # before the first table, behind the keys that stand alone
        place = next((index for index, row in enumerate(rows) if row.lstrip().startswith("[")), len(rows))
        lines = ["", "[values]", *(f"{name} = {value}" for name, value in new.items())]
    elif re.match(r"\s*\[", rows[place - 1]):  # [values]
        lines = [f"{name} = {value}" for name, value in new.items()]
    else:  # values.name = ...
        lines = [f"values.{name} = {value}" for name, value in new.items()]
    return "\n".join([*rows[:place], *lines, *rows[place:]]) + "\n"


def _with_effects(text: str, effects: Sequence[AttachedEffect]) -> str:
    """Add effects behind those the text has."""
    found = locate(text).spans
    if ("effects",) not in found:
        return "\n".join([text.rstrip() + "\n", *(f"[[effects]]\n{_rows(one)}" for one in effects)])
    if not effects:
        return text
    inline = ", ".join("{ " + ", ".join(_rows(one).splitlines()) + " }" for one in effects)
    last = [span for path, span in found.items() if path[:1] == ("effects",) and len(path) == 2]
    if not last:
        return replaced(text, {("effects",): f"[{inline}]"})
    return _behind(text, max(last)[1], f", {inline}")


def _behind(text: str, place: int, more: str) -> str:
    encoded = text.encode()
    return (encoded[:place] + more.encode() + encoded[place:]).decode()


def _rows(attached: AttachedEffect) -> str:
    effect = attached.effect
    values = ", ".join(f"{name} = {value!r}" for name, value in attached.named_values.items())
    return (
        f"effect = {_quoted(_name_of(effect))}\n"
        f"site = {_quoted(attached.site)}\n"
        f"kind = {_quoted(effect.kind)}\n"
        f"values = {{ {values} }}\n"
    )


def _name_of(effect: Effect) -> str:
    """Return what `labrun.effects.load_effect` takes for it: its id, its file, or where its module keeps it."""
    if any(one.id == effect.id and one.kind == effect.kind for one in effects(without=())):
        return effect.id
    if effect.origin:
        return f"{effect.origin}:{effect.id}"
    module = sys.modules[effect.function.python.__module__]
    for name, value in vars(module).items():
        if value == effect or (isinstance(value, tuple) and effect in value):
            return f"{module.__name__}:{name}"
    raise ModelError(
        f"effect {effect.id} cannot be named in a file",
        hint="install it as an entry point of the group labrun.effects, or keep it at the top of its module",
    )
