"""The corrected model as a file: another model's text with other values, and with effects at its sites."""

import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from labrun.effects import AttachedEffect
from labrun.errors import ModelError
from labrun.models.loading import model_file
from labrun.models.model import Model
from labrun.models.toml_edits import quoted, replaced, with_effects, with_parameters, with_values
from labrun.toml import suggest


def corrected_model_text(
    model: Model,
    text_or_path: str | Path,
    values: Mapping[str, float],
    effects: Sequence[AttachedEffect] = (),
    remarks: str | Sequence[str] = (),
    *,
    folder: Path | None = None,
    heading: str = "Corrected by labrun",
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
    data = tomllib.loads(text)
    if "base" in data:
        body = with_values(text, changed)
        if path is not None and str(data["base"]).endswith(".toml"):
            base = _from_folder(path.parent / data["base"], folder)
            body = replaced(body, {("base",): quoted(base)})
    elif "mujoco" in data or not text:
        named = path is None or (path.suffix == ".toml" and Path(given).suffix != ".toml")
        base = given if named or path is None else _from_folder(path, folder)
        body = with_values(f"base = {quoted(base)}\n", changed)
    else:
        _refuse_strangers(model, text, changed)
        body = with_parameters(text, changed)
    origin = path.name if path is not None else given if not text else model.source or model.name
    top = _comment(model, f"{heading} from {origin}", changed, remarks)
    return top + with_effects(body, effects)


def _from_folder(path: Path, folder: Path | None) -> str:
    """Return a path as a file in that folder would name it."""
    absolute = path.resolve()
    return str(absolute) if folder is None else os.path.relpath(absolute, folder.resolve())


def _refuse_strangers(model: Model, text: str, changed: Mapping[str, float]) -> None:
    there = tomllib.loads(text).get("parameters", {})
    for name in changed:
        if name not in there:
            raise ModelError(f"the text given for model {model.name} has no parameter {name!r}")


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
