"""Reference of the keys of an experiment file, from its pydantic models and `keys.toml`.

The page docs/keys.md and ``labrun keys`` are both made from this.
"""

import importlib
import inspect
import re
import tomllib
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from labrun import registry
from labrun.devices import DeviceSettings
from labrun.errors import PluginError, RequestError
from labrun.experiment.experiment import Experiment
from labrun.toml import Expression, PluginTable, suggest

WORDS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_name("keys.toml").read_text(encoding="utf-8")
)
"""What each key means, by model and key."""
REQUIRED = "must be given"
_GROUPS = {
    "devices": "labrun.devices", "scene": "labrun.scenes", "gait": "labrun.gaits",
    "objectives": "labrun.objectives", "reference": "labrun.references", "feedback": "labrun.feedbacks",
    "controllers": "labrun.controllers",
}  # fmt: skip
"""Which plugins a table may name, by the key of the table."""
_UNITS = {
    "deg": "deg", "hz": "Hz", "s": "s", "ms": "ms", "us": "us", "m": "m", "mm": "mm", "n": "N", "n_m": "N m",
    "c": "degC", "deg_s": "deg/s", "m_s": "m/s", "g": "g", "per_s": "1/s",
}  # fmt: skip
_ATTRIBUTES = re.compile(r"^([\w, ]+)\n((?:[ ]{4}.*\n?|\n)+)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Key:
    """One key: place in the file, what it takes, value if not given (in TOML; "" for none), unit, meaning."""

    path: str
    takes: str
    default: str
    unit: str
    meaning: str


def keys_at(path: str = "") -> list[Key]:
    """Return what stands at a place of the experiment file: one key, or those of a table.

    Parameters
    ----------
    path
        Such as ``trial.settle``, ``trial.settle.hold_s``, ``rig.devices.dynamixel`` (the keys of a plugin) or just
        ``dynamixel``; empty for the top of the file. Brackets as in the file, ``[trial.settle]``, may stand.

    Raises
    ------
    RequestError
        There is no such key; names the nearest.
    """
    parts = [part for part in path.strip("[]").split(".") if part]
    if parts and parts[0] not in Experiment.model_fields:
        for group in dict.fromkeys(_GROUPS.values()):
            if registry.is_installed(group, parts[0]):
                return _below(_plugin_model(group, parts[0]), parts[0], parts[1:])
    return _below(Experiment, "", parts)


def _in_tables(fields: dict[str, Any], path: str) -> list[str]:
    """Return where tables of the top have a key that was asked for without its table."""
    inner = {table: _model_within(field.annotation)[0] for table, field in fields.items()}
    name = path.partition(".")[0]
    return [
        f"{table}.{path}"
        for table, model in inner.items()
        if model is not None and name in dict(_fields(model))
    ]


def _below(model: type[BaseModel], where: str, parts: list[str]) -> list[Key]:
    """Return the keys of a table, or of what `parts` leads to in it."""
    if not parts:
        return _table(model, where)
    name, *rest = parts
    fields = dict(_fields(model))
    if name not in fields:
        location = f"[{where}]" if where else "the top of an experiment file"
        deeper = _in_tables(fields, ".".join(parts)) if not where else []
        hint = f"labrun keys {deeper[0]}" if len(deeper) == 1 else suggest(name, deeper or list(fields))
        raise RequestError(f"{location} has no key {name!r}", hint=hint)
    at, group = f"{where}.{name}" if where else name, _GROUPS.get(name)
    if group is not None and rest and registry.is_installed(group, rest[0]):
        return _below(_plugin_model(group, rest[0]), f"{at}.{rest[0]}", rest[1:])
    own = _key(model, name, fields[name], at)
    if at == "gait.joints":
        return [own, *(key for gait in registry.names("labrun.gaits") for key in _joint_keys(gait, at))]
    inner, by_name = _model_within(fields[name].annotation)
    if inner is None and rest:
        raise RequestError(f"{at} is not a table, so it has no keys", hint=f"labrun keys {at}")
    if inner is None:
        return [own]
    if rest:
        if by_name and rest[0] not in dict(_fields(inner)):
            at, rest = f"{at}.{rest[0]}", rest[1:]
        return _below(DeviceSettings if name == "devices" and rest else inner, at, rest)
    plugins = registry.names(group) if group else []
    return [
        own,
        *_table(inner, f"{at}.NAME" if by_name else at),
        *(
            Key(f"{at}.{plugin}", "keys of this plugin", "", "", "")
            for plugin in plugins
            if not plugin.startswith("simulated-")
        ),
    ]


def model_of(name: str) -> type[BaseModel]:
    """Return a model by the name of its class in the experiment file, or by ``package.module:Class``."""
    module, _, class_name = name.rpartition(":")
    model: type[BaseModel] = getattr(importlib.import_module(module or "labrun.experiment"), class_name)
    return model


def explained(model: type[BaseModel]) -> list[Key]:
    """Return the keys of a table of the file.

    Raises ValueError: a key that `keys.toml` does not explain, or an explained one that is none.
    """
    words, keys = WORDS.get(model.__name__, {}), dict(_fields(model))
    if unsaid := [key for key in keys if key not in words]:
        raise ValueError(
            f"keys.toml does not say what these keys of [{model.__name__}] mean: {', '.join(unsaid)}"
        )
    if extra := [key for key in words if key not in keys]:
        raise ValueError(f"keys.toml explains keys that [{model.__name__}] does not have: {', '.join(extra)}")
    return [_key(model, name, key, name) for name, key in keys.items()]


def _table(model: type[BaseModel], where: str) -> list[Key]:
    return [_key(model, name, info, f"{where}.{name}" if where else name) for name, info in _fields(model)]


def _fields(model: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    return [(field.alias or name, field) for name, field in model.model_fields.items()]


def _key(model: type[BaseModel], name: str, field: FieldInfo, where: str) -> Key:
    meaning = next(
        (WORDS[class_.__name__][name] for class_ in model.__mro__ if name in WORDS.get(class_.__name__, {})),
        "",
    )
    if not meaning:
        meaning = next(
            (attributes[name] for class_ in model.__mro__ if name in (attributes := _attributes(class_))), ""
        )
    return Key(where, _taken(field.annotation, field.metadata), _default(field), _unit(name), meaning)


@cache
def _attributes(model: type) -> dict[str, str]:
    """Return the description of each key from the numpydoc docstring of a plugin's settings."""
    text = inspect.getdoc(model) or ""
    _, _, listed = text.partition("Attributes\n----------\n")
    return {
        name.strip(): " ".join(match[2].split())
        for match in _ATTRIBUTES.finditer(listed)
        for name in match[1].split(",")
    }


def _unit(name: str) -> str:
    parts = name.split("_")
    return next(
        (_UNITS[end] for first in range(1, len(parts)) if (end := "_".join(parts[first:])) in _UNITS), ""
    )


def _plugin_model(group: str, name: str) -> type[BaseModel]:
    plugin = registry.load(group, name)
    model = getattr(plugin, "Settings", None) or (
        DeviceSettings if group == "labrun.devices" else PluginTable
    )
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        raise PluginError(f"plugin {name!r} does not say which keys it takes", hint="see labrun plugins")
    return model


def _joint_keys(gait: str, where: str) -> list[Key]:
    model = getattr(registry.load("labrun.gaits", gait), "JointKeys", None)
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return []
    return [
        Key(key.path, f"{key.takes} ({gait})", key.default, key.unit, key.meaning)
        for key in _table(model, f"{where}.NAME")
    ]


def _model_within(annotation: Any) -> tuple[type[BaseModel] | None, bool]:
    """Return the table that a field holds, and whether it holds several by name."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, False
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (dict, Mapping) or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return _model_within(inner[1])[0], True
    for member in inner if origin in (Annotated, Union, types.UnionType) else ():
        inner = _model_within(member)
        if inner[0] is not None:
            return inner
    return None, False


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return REQUIRED
    value = field.get_default(call_default_factory=True)
    if value is None or value in ({}, []) or value is PydanticUndefined:
        return ""
    if isinstance(value, BaseModel):
        return (
            "its own defaults"
            if value.model_fields_set == set()
            else _toml(value.model_dump(exclude_unset=True))
        )
    return _toml(value)


def _toml(value: Any) -> str:
    if isinstance(value, Expression):
        return _toml(value.given)
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _taken(annotation: Any, metadata: list[Any]) -> str:
    kinds = list(dict.fromkeys(_kinds(annotation)))
    if "number" in kinds and "whole number" in kinds:
        kinds.remove("whole number")
    bounds = [bound for item in metadata for bound in _bounds(item)]
    return " or ".join(kinds) + (f", {' and '.join(bounds)}" if bounds else "")


def _bounds(item: Any) -> Iterator[str]:
    for name, words in (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most")):
        if (bound := getattr(item, name, None)) is not None:
            yield f"{words} {bound:g}"


def _kinds(annotation: Any) -> Iterator[str]:
    """Return the words for a type in a TOML file."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        bounds = [bound for item in inner[1:] for bound in _bounds(item)]
        kinds = " or ".join(dict.fromkeys(_kinds(inner[0])))
        yield kinds + (f" {' and '.join(bounds)}" if bounds else "")
    elif origin in (Union, types.UnionType):
        members = [member for member in inner if member is not type(None)]
        if str in members and float in members:
            members = [member for member in members if member not in (str, float, int)]
            yield "number or text"
        for member in members:
            yield from _kinds(member)
    elif origin is Literal:
        yield " or ".join(f"`{_toml(value)}`" for value in inner)
    elif origin in (list, tuple):
        yield f"list of {' or '.join(dict.fromkeys(_kinds(inner[0])))}"
    elif origin in (dict, Mapping) or (isinstance(origin, type) and issubclass(origin, Mapping)):
        yield "table by name"
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield "table"
    else:
        yield {
            Expression: "number or text",
            float: "number",
            int: "whole number",
            str: "text",
            bool: "true or false",
        }.get(annotation, "any value")
