"""Models written with corrections: other values, and effects behind those they carry."""

import math
import os
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import tomli_w

from labrun.effects import AttachedEffect, Effect, effects
from labrun.errors import ModelError
from labrun.models.finding import model_file
from labrun.models.model import Model
from labrun.toml import KeyPath, locate, replaced, suggest


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
    parameters = {parameter.name: parameter for parameter in model.parameters}
    changed = {}
    for name, given in values.items():
        if name not in parameters:
            raise ModelError(
                f"model {model.name} has no parameter {name!r}", hint=suggest(name, list(parameters))
            )
        parameter, value = parameters[name], float(given)
        if not math.isfinite(value) or not parameter.lower <= value <= parameter.upper:
            raise ModelError(
                f"{name} = {value:g} cannot be written: model {model.name} takes {parameter.lower:g} to "
                f"{parameter.upper:g}"
            )
        if value != parameter.value:
            changed[name] = value
    return changed


def _comment(model: Model, heading: str, changed: Mapping[str, float], remarks: str | Sequence[str]) -> str:
    sentences = [remarks] if isinstance(remarks, str) else list(remarks)
    lines = [heading, *sentences]
    parameters = {parameter.name: parameter for parameter in model.parameters}
    for name, value in changed.items():
        unit = "" if parameters[name].unit == "1" else f" {parameters[name].unit}"
        lines.append(f"{name}: {parameters[name].value:g}{unit} became {value:g}{unit}")
    return "".join(f"# {line}\n" for text in lines for line in text.splitlines()) + "\n"


def _quoted(text: str) -> str:
    """Return text as TOML writes it."""
    return tomli_w.dumps({"a": text}).removeprefix("a = ").strip()


def _with_parameters(text: str, values: Mapping[str, float]) -> str:
    """Replace parameter values of a model with equations, however it writes them."""
    spans = locate(text).spans
    paths: dict[KeyPath, str] = {}
    for name, value in values.items():
        path = ("parameters", name)
        paths[(*path, "value") if (*path, "value") in spans else path] = repr(value)
    return replaced(text, paths)


def _with_values(text: str, values: Mapping[str, float]) -> str:
    """Replace the values of a model with a base, and add those that are not there yet."""
    there = {("values", name) for name in values} & locate(text).spans.keys()
    text = replaced(text, {path: repr(values[str(path[-1])]) for path in there})
    new = {name: repr(value) for name, value in values.items() if ("values", name) not in there}
    if not new:
        return text
    positions = locate(text)
    rows = text.splitlines()
    head = positions.keys.get(("values",))
    header = None if head is None else head.line
    if ("values",) in positions.spans:  # values = { ... }
        inner = [f"{name} = {value}" for name, value in new.items()]
        names = [path for path in positions.spans if path[:1] == ("values",) and len(path) == 2]
        if not names:
            return replaced(text, {("values",): f"{{ {', '.join(inner)} }}"})
        last = max(names, key=lambda path: positions.spans[path])
        return _behind(text, positions.spans[last][1], f", {', '.join(inner)}")
    if header is None:  # before the first table, behind the keys that stand alone
        header = next((index for index, row in enumerate(rows) if row.lstrip().startswith("[")), len(rows))
        lines = ["", "[values]", *(f"{name} = {value}" for name, value in new.items())]
    elif re.match(r"\s*\[", rows[header - 1]):  # [values]
        lines = [f"{name} = {value}" for name, value in new.items()]
    else:  # values.name = ...
        lines = [f"values.{name} = {value}" for name, value in new.items()]
    return "\n".join([*rows[:header], *lines, *rows[header:]]) + "\n"


def _with_effects(text: str, effects: Sequence[AttachedEffect]) -> str:
    """Add effects behind those the text has."""
    spans = locate(text).spans
    if ("effects",) not in spans:
        return "\n".join([text.rstrip() + "\n", *(f"[[effects]]\n{_rows(effect)}" for effect in effects)])
    if not effects:
        return text
    inline = ", ".join("{ " + ", ".join(_rows(effect).splitlines()) + " }" for effect in effects)
    last = [span for path, span in spans.items() if path[:1] == ("effects",) and len(path) == 2]
    if not last:
        return replaced(text, {("effects",): f"[{inline}]"})
    return _behind(text, max(last)[1], f", {inline}")


def _behind(text: str, index: int, more: str) -> str:
    encoded = text.encode()
    return (encoded[:index] + more.encode() + encoded[index:]).decode()


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
    if any(other.id == effect.id and other.kind == effect.kind for other in effects(without=())):
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
