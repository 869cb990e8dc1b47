"""``--set key=value``: any key of the file, by its dotted name."""

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from labrun.errors import SpecError
from labrun.toml import KeyPath, dotted, suggest

_BARE_WORD = re.compile(r"[^\"'\[\]{}=]+")


class OverrideError(SpecError):
    """An override cannot be read, or names a place that is not there."""


def apply_overrides(data: dict[str, Any], overrides: Sequence[str]) -> dict[KeyPath, str]:
    """Set keys of the read file in place.

    Parameters
    ----------
    data
        The file as tomllib gave it.
    overrides
        Texts ``key=value``: the key dotted, a list's entry by its number (``run.conditions.0.release_deg``), the value
        in TOML's syntax; a bare word is text.

    Returns
    -------
    dict
        The paths that were set, and the override each came from.

    Raises
    ------
    OverrideError
        All overrides that cannot be read or placed.
    """
    origins: dict[KeyPath, str] = {}
    wrong: list[str] = []
    for override in overrides:
        try:
            path, value = _read(override)
            path = _put(data, path, value, override)
        except OverrideError as error:
            wrong.append(str(error))
        else:
            origins[path] = f"--set {override}"
    if wrong:
        raise OverrideError("\n".join(wrong))
    return origins


def _read(override: str) -> tuple[KeyPath, Any]:
    key, sign, text = override.partition("=")
    key, text = key.strip(), text.strip()
    if not sign or not key or not text:
        raise OverrideError(
            f"--set {override}: not of the form key=value", hint="example: --set trial.repeats=5"
        )
    path = _path(key, override)
    try:
        return path, tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        if _BARE_WORD.fullmatch(text):
            return path, text
        raise OverrideError(f"--set {override}: {dotted(path)}: the value is not TOML: {error}") from error


def _path(key: str, override: str) -> KeyPath:
    try:
        node: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError as error:
        hint = "the parts of a key stand between dots, for example rig.devices.tail.port"
        raise OverrideError(f'--set {override}: "{key}" is not a key', hint=hint) from error
    path: list[str] = []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        path.append(part)
    return tuple(path)


def _put(data: dict[str, Any], path: KeyPath, value: Any, override: str) -> KeyPath:
    current: Any = data
    real: KeyPath = ()
    for number, part in enumerate(path):
        last = number == len(path) - 1
        step: str | int = part
        if isinstance(current, list):
            step = _index(current, str(part), real, override)
        elif not isinstance(current, dict):
            raise OverrideError(
                f"--set {override}: {dotted(real)} is a value, not a table; it has no key {dotted(path[number:])}"
            )
        real = (*real, step)
        if last:
            current[step] = value
        else:
            current = current[step] if isinstance(step, int) else current.setdefault(step, {})
    return real


def _index(items: list[Any], part: str, path: KeyPath, override: str) -> int:
    known = [str(number) for number in range(len(items))]
    if part not in known:
        hint = suggest(part, known, kind="entries")
        raise OverrideError(f"--set {override}: {dotted(path)} is a list and has no entry {part}; {hint}")
    return int(part)
