"""The tables of keys.md, made from the pydantic models that check an experiment file.

Below a line ``<!-- keys: TrialTable -->`` stands the table of that model. What a key means is said in `keys.toml`;
a key without a word there, or a word without its key, is an error. ``python docs/hooks/keys.py`` writes the page anew.
"""

import importlib
import re
import tomllib
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from labrun.toml import FUNCTIONS, Expression

PAGE = Path(__file__).parents[1] / "keys.md"
WORDS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_name("keys.toml").read_text(encoding="utf-8")
)
_MARK = re.compile(r"^<!-- keys: ([\w.:]+) -->\n(?:\n(?:\|.*\n)+)?", re.MULTILINE)
_FUNCTIONS = re.compile(r"^<!-- functions -->\n(?:\n(?:\|.*\n)+)?", re.MULTILINE)
_EXPERIMENT = "labrun.spec"


def page(markdown: str) -> str:
    """Return the page with its tables as the models are today."""
    markdown = _FUNCTIONS.sub(lambda mark: f"{mark[0].splitlines()[0]}\n\n{functions()}\n", markdown)
    return _MARK.sub(lambda mark: f"{mark[0].splitlines()[0]}\n\n{table(mark[1])}\n", markdown)


def functions() -> str:
    """Return the functions of expressions as a Markdown table."""
    rows = [f"| `{name}` | {function.meaning} |" for name, function in FUNCTIONS.items()]
    return "\n".join(["| Function | |", "|---|---|", *rows])


def model_of(name: str) -> type[BaseModel]:
    """Return a model by the name of its class in the experiment file, or by ``package.module:Class``."""
    module, _, class_name = name.rpartition(":")
    return getattr(importlib.import_module(module or _EXPERIMENT), class_name)


def table(name: str) -> str:
    """Return the keys of a model as a Markdown table.

    Raises
    ------
    ValueError
        A key that `keys.toml` does not explain, or an explained one that is none.
    """
    model = model_of(name)
    words = WORDS.get(name.rpartition(":")[2], {})
    keys = {field.alias or key: field for key, field in model.model_fields.items()}
    if unsaid := [key for key in keys if key not in words]:
        raise ValueError(
            f"docs/hooks/keys.toml does not say what these keys of [{name}] mean: {', '.join(unsaid)}"
        )
    if extra := [key for key in words if key not in keys]:
        raise ValueError(
            f"docs/hooks/keys.toml explains keys that [{name}] does not have: {', '.join(extra)}"
        )
    rows = [
        f"| `{key}` | {_taken(field.annotation, field.metadata)} | {_default(field)} | {words[key]} |"
        for key, field in keys.items()
    ]
    return "\n".join(["| Key | Takes | If not given | |", "|---|---|---|---|", *rows])


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**must be given**"
    value = field.get_default(call_default_factory=True)
    if value is None or value in ({}, []) or value is PydanticUndefined:
        return "-"
    if isinstance(value, BaseModel):
        return (
            "its own defaults"
            if value.model_fields_set == set()
            else f"`{_toml(value.model_dump(exclude_unset=True))}`"
        )
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, Expression):
        return _toml(value.given)
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
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
    """Say what a type is to the writer of a TOML file."""
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


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
