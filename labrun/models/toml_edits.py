"""Changes to the text of a model file that leave its comments and its layout alone."""

import re
import sys
from collections.abc import Mapping, Sequence

from labrun.effects import AttachedEffect, Effect, effects
from labrun.errors import ModelError
from labrun.toml import KeyPath, locate


def quoted(text: str) -> str:
    """Return text as TOML writes it."""
    import tomli_w

    return tomli_w.dumps({"a": text}).removeprefix("a = ").strip()


def replaced(text: str, values: Mapping[KeyPath, str]) -> str:
    """Put other values where those of the text stand."""
    found = locate(text).spans
    encoded = text.encode()
    places = {found[path]: value for path, value in values.items()}
    for (begin, end), value in sorted(places.items(), reverse=True):
        encoded = encoded[:begin] + value.encode() + encoded[end:]
    return encoded.decode()


def with_parameters(text: str, values: Mapping[str, float]) -> str:
    """Replace parameter values of a model with equations, however it writes them."""
    found = locate(text).spans
    paths: dict[KeyPath, str] = {}
    for name, value in values.items():
        path = ("parameters", name)
        paths[(*path, "value") if (*path, "value") in found else path] = repr(value)
    return replaced(text, paths)


def with_values(text: str, values: Mapping[str, float]) -> str:
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


def with_effects(text: str, effects: Sequence[AttachedEffect]) -> str:
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
        f"effect = {quoted(_name_of(effect))}\n"
        f"site = {quoted(attached.site)}\n"
        f"kind = {quoted(effect.kind)}\n"
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
