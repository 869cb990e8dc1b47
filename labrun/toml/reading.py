"""From a TOML file of ours to a checked value, or to everything that is wrong with it, in the words of the file."""

import copy
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from labrun.errors import RequestError, SpecError
from labrun.toml.faults import Fault, KeyPath, LocatedFault, dotted, locate, refusal, shown
from labrun.toml.names import UNITS, convert, nearest, same_quantity, split_unit, suggest, unit_of


class Keys(BaseModel):
    """Keys of a table: unknown ones are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Table(Keys):
    """A table of our files."""

    # Strict: TOML has types of its own, and `repeats = "3"` is a slip of the pen, not a number.
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class PluginTable(BaseModel):
    """A table that names a plugin; its further keys belong to the plugin, which checks them."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

    plugin: str

    @property
    def settings(self) -> dict[str, Any]:
        """The plugin's own keys."""
        return dict(self.model_extra or {})


Model = TypeVar("Model", bound=BaseModel)
_ROUNDS = 6
"""A table's own rules are read only once its keys hold: so what does not hold is left out, and it is read again."""


def validate(
    model: type[Model], data: Mapping[str, Any], base: KeyPath = (), *, also: Sequence[str] = ()
) -> tuple[Model | None, list[Fault]]:
    """Read `data` as a model.

    Parameters
    ----------
    model
        The model of the table.
    data
        The table as tomllib gave it.
    base
        Where in the file the table stands.
    also
        Keys of the same table that someone else reads: worth a suggestion when a key is misspelt.

    Returns
    -------
    The model (None if anything is wrong), and everything that is wrong.
    """
    checked, faults = mend(model, data, base, also=also)
    return (None if faults else checked), faults


def mend(
    model: type[Model], data: Mapping[str, Any], base: KeyPath = (), *, also: Sequence[str] = ()
) -> tuple[Model | None, list[Fault]]:
    """Read `data` as `validate` does, but give the model of what is left once everything wrong is left out.

    Only for looking further: nothing may be run with it.
    """
    try:
        return _read(model, data), []
    except ValidationError as error:
        errors = error.errors(include_url=False)
    repair = _Repair(model, copy.deepcopy(dict(data)), also)
    faults: dict[tuple[KeyPath, str], Fault] = {}
    mended: Model | None = None
    for _ in range(_ROUNDS):
        for fault in repair.faults(errors):
            faults.setdefault((fault.path, fault.message), fault)
        if not repair.apply():
            break
        try:
            mended = _read(model, repair.data)
            break
        except ValidationError as error:
            errors = error.errors(include_url=False)
    return mended, [Fault((*base, *item.path), item.message, item.at_value) for item in faults.values()]


def checked(model: type[Model], data: Mapping[str, Any], base: KeyPath = ()) -> Model:
    """Read `data` as a model, where no file is at hand to point into.

    Raises
    ------
    SpecError
        All keys that do not hold, below `base`.
    """
    value, faults = validate(model, data, base)
    if value is None or faults:
        raise SpecError("; ".join(f"{dotted(fault.path)}: {fault.message}" for fault in faults))
    return value


def _read(model: type[Model], data: Mapping[str, Any]) -> Model:
    """Read strictly: the number 3 is not the text "3".

    By way of JSON, where strictness still takes a list for a tuple, and a text for a path.
    """
    return model.model_validate_json(json.dumps(data, default=str), strict=True)


def keys_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """Return the keys that the table at `path` of a model may have; empty where any key is allowed."""
    return [key for table in _models(model, path) for key in _keys(table)]


def _keys(model: type[BaseModel]) -> list[str]:
    return [info.alias or name for name, info in model.model_fields.items()]


def _models(annotation: Any, path: KeyPath) -> Iterator[type[BaseModel]]:
    origin = get_origin(annotation)
    if origin in (Annotated, Union, UnionType):
        members = get_args(annotation)[:1] if origin is Annotated else get_args(annotation)
        for member in members:
            yield from _models(member, path)
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if not path:
            yield annotation
            return
        for name, info in annotation.model_fields.items():
            if path[0] == (info.alias or name):
                yield from _models(info.annotation, path[1:])
    elif path and origin in (dict, Mapping, list, tuple) and get_args(annotation):
        yield from _models(get_args(annotation)[-1], path[1:])


def unknown_key(path: KeyPath, value: object, known: Sequence[str]) -> Fault:
    """Return the fault of a key that is not one: a wrong unit, or the nearest known key."""
    key = str(path[-1])
    twin = same_quantity(key, known)
    if twin is None:
        return Fault(path, f"unknown key; {suggest(key, known, kind='known keys')}")
    stem, suffix = split_unit(key)
    converted = convert(value, key, twin)
    write = f"{twin} = {converted:g}" if converted is not None else twin
    if suffix is None:
        return Fault(path, f"the unit is missing: {stem} is given in {unit_of(twin)}; write {twin}")
    if UNITS[suffix].label == unit_of(twin):
        known_suffix = split_unit(twin)[1]
        return Fault(
            path, f"unknown key; the suffix of {UNITS[suffix].label} is _{known_suffix}; write {write}"
        )
    return Fault(path, f"wrong unit {UNITS[suffix].label}: {stem} is given in {unit_of(twin)}; write {write}")


_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "list_type": "a list [...]",
    "tuple_type": "a list [...]",
    "dict_type": "a table { ... }",
    "mapping_type": "a table { ... }",
    "model_type": "a table { ... }",
    "model_attributes_type": "a table { ... }",
    "finite_number": "a finite number",
    "expression_type": "a number or text in quotes",
    "none_required": "nothing",
}
_BOUNDS = {
    "greater_than": ("more than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}
_LENGTHS = {"too_short": ("at least", "min_length"), "too_long": ("at most", "max_length")}
_NUMBERS = ("int_type", "float_type", "int_from_float")


def _expectation(error: ErrorDetails, path: KeyPath) -> str:
    """Return what was expected at a key, with bound and unit: "more than 0 s"."""
    kind, context = error["type"], error.get("ctx", {})
    key = next((part for part in reversed(path) if isinstance(part, str)), "")
    unit = unit_of(key)
    tail = f" {unit}" if unit else ""
    if kind in _BOUNDS:
        words, name = _BOUNDS[kind]
        return f"{words} {context[name]:g}{tail}"
    if kind == "literal_error":
        choices = [
            str(choice) for choice in context["expected"].replace("'", '"').replace(" or ", ", ").split(", ")
        ]
        near = nearest(str(error["input"]), [choice.strip('"') for choice in choices])
        return " or ".join(choices) + (f' (did you mean "{near}"?)' if near else "")
    if kind in _LENGTHS:
        words, name = _LENGTHS[kind]
        return f"{words} {context[name]} " + ("entry" if context[name] == 1 else "entries")
    if kind in _EXPECTED:
        of_tables = kind == "list_type" and isinstance(error["input"], Mapping)
        expected = "a list of tables [{ ... }, ...]" if of_tables else _EXPECTED[kind]
        return expected + (f" ({unit})" if unit and kind in _NUMBERS else "")
    return f"{error['msg'][:1].lower()}{error['msg'][1:]}, not {shown(error['input'])}"


class _Repair:
    """Turns errors into faults, and sets right what they are about so that the next look sees further."""

    def __init__(self, model: type[BaseModel], data: dict[str, Any], also: Sequence[str]) -> None:
        self.data = data
        self._also = list(also)
        self._model = model
        self._touched: set[KeyPath] = set()
        self._refused: set[KeyPath] = set()
        self._renames: dict[KeyPath, str] = {}
        self._removals: set[KeyPath] = set()
        self._unknown_keys: set[KeyPath] = set()

    def faults(self, errors: Sequence[ErrorDetails]) -> list[Fault]:
        self._renames, self._removals = {}, set()
        faults: list[Fault] = []
        expected: dict[KeyPath, list[str]] = {}
        for error in errors:
            path = self._real_path(error)
            if self._follows_from_repair(path):
                continue
            if error["type"] == "extra_forbidden":
                faults.append(self._unknown(path))
            elif error["type"] == "faults":
                faults += self._faults(path, error)
            elif error["type"] == "too_short" and any(item[: len(path)] == path for item in self._touched):
                self._removals.add(path)
            elif error["type"] == "expression":
                self._removals.add(path)
                faults.append(Fault(path, error["msg"], at_value=True))
            elif error["type"] == "value_error":  # a validator's own sentence
                self._removals.add(path)
                faults.append(Fault(path, error["msg"].removeprefix("Value error, "), at_value=True))
            elif error["type"] != "missing":
                expected.setdefault(path, []).append(_expectation(error, path))
        faults += self._missing(errors)
        for path, texts in expected.items():
            self._removals.add(path)
            faults.append(Fault(path, "expected " + " or ".join(dict.fromkeys(texts)), at_value=True))
        return faults

    def apply(self) -> bool:
        """Rename what was misspelt and remove what does not hold; tell whether anything changed."""
        for path, name in self._renames.items():
            table = _get(self.data, path[:-1])
            if isinstance(table, dict) and path[-1] in table:
                value = table.pop(path[-1])
                table.setdefault(name, value)
                self._touched |= {path, (*path[:-1], name)}
        changed = bool(self._renames)
        for path in sorted(self._removals, key=_deepest_last_first):
            table = _get(self.data, path[:-1])
            if isinstance(table, dict) and path and path[-1] in table:
                del table[path[-1]]
                self._touched.add(path)
                if path not in self._unknown_keys:
                    self._refused.add(path)
                changed = True
            elif path and isinstance(table, list) and isinstance(path[-1], int) and path[-1] < len(table):
                del table[path[-1]]
                self._touched.add(path[:-1])
                changed = True
        return changed

    def _unknown(self, path: KeyPath) -> Fault:
        known = keys_at(self._model, path[:-1]) + (self._also if len(path) == 1 else [])
        table = _get(self.data, path[:-1])
        free = [key for key in known if key not in table]
        key = str(path[-1])
        meant = same_quantity(key, known) or nearest(key, known)
        if meant in free and meant not in self._also:
            self._renames[path] = meant
        else:
            self._removals.add(path)
            self._unknown_keys.add(path)
        return unknown_key(path, table.get(path[-1]), known)

    def _faults(self, path: KeyPath, error: ErrorDetails) -> Iterator[Fault]:
        for key, message, of in error["ctx"]["faults"]:
            full = (*path, *key)
            # A rule over several keys says nothing new once one of them, or something inside, has been refused.
            refused = any(
                (item[:-1] == path and (of is None or item[-1] in of)) or (key and item[: len(full)] == full)
                for item in self._refused
            )
            if not refused and not self._follows_from_repair(full):
                yield Fault(full, message, at_value=bool(key))
            if key:
                self._removals.add(full)

    def _missing(self, errors: Sequence[ErrorDetails]) -> Iterator[Fault]:
        renamed = {(*path[:-1], name) for path, name in self._renames.items()}
        for error in errors:
            path = self._real_path(error)
            if error["type"] == "missing" and path not in renamed:
                if not self._follows_from_repair(path):
                    yield Fault(path[:-1], f'the key "{path[-1]}" is missing')
                self._removals.add(path[:-1])

    def _follows_from_repair(self, path: KeyPath) -> bool:
        return any(path[: len(item)] == item for item in self._touched)

    def _real_path(self, error: ErrorDetails) -> KeyPath:
        """Return an error's place in the data: pydantic adds the tried members of unions to its own."""
        path: KeyPath = ()
        current: Any = self.data
        *inner, last = error["loc"] or ("",)
        for part in (*inner, last):
            inside = _child(current, part)
            if inside is not _ABSENT:
                path, current = (*path, part), inside
        if error["type"] == "missing" and isinstance(current, Mapping):
            path = (*path, last)
        return path


def _deepest_last_first(path: KeyPath) -> tuple[int, list[tuple[int, str]]]:
    # Entries of a list go from the last to the first, so that those still to go keep their numbers.
    return -len(path), [(-part, "") if isinstance(part, int) else (0, part) for part in path]


_ABSENT = object()


def _child(data: Any, part: str | int) -> Any:
    if isinstance(data, Mapping):
        return data.get(part, _ABSENT)
    if isinstance(data, list) and isinstance(part, int) and part < len(data):
        return data[part]
    return _ABSENT


def _get(data: Any, path: KeyPath) -> Any:
    for part in path:
        data = _child(data, part)  # absent once it was removed along with what held it
    return data


def text_of(path: Path, *, kind: type[RequestError] = RequestError, what: str = "file") -> str:
    """Return the text of a file; the error says `what` it is."""
    try:
        return path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except OSError as error:
        raise kind(f"{what} {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise kind(f"{what} {path} is not text in UTF-8 (byte {error.start})") from error


def parsed(text: str, name: str, *, kind: type[RequestError] = RequestError) -> dict[str, Any]:
    """Return a text's tables; the error names the file, line and column."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise refusal(kind, name, [LocatedFault(name, None, None, "", None, "nested too deeply")]) from error
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        match = re.search(r" \(at line (\d+), column (\d+)\)$", message)
        if match is not None:
            line, column = int(match[1]), int(match[2])
            message = message[: match.start()]
        else:  # at the end of the text
            line, column = text.count("\n") + 1, len(text.rpartition("\n")[2]) + 1
            message = re.sub(r" \(at end of document\)$", " at the end of the file", message)
        fault = LocatedFault(f"{name}:{line}:{column}", line, column, "", None, f"not valid TOML: {message}")
        raise refusal(kind, name, [fault]) from error


class Places:
    """Finds the place of each fault: a line of the file, or the override that brought the key.

    Parameters
    ----------
    name
        The file's, for messages.
    text
        Its content.
    data
        What it says, overrides included.
    origins
        The keys that overrides have set, and the override each came from.
    """

    def __init__(
        self, name: str, text: str, data: Mapping[str, Any], origins: Mapping[KeyPath, str] | None = None
    ) -> None:
        self._name = name
        self._positions = locate(text)
        self._data = data
        self._origins = origins or {}

    def of_all(self, faults: Sequence[Fault]) -> list[LocatedFault]:
        """Return the faults with their places, each once, in the order of their lines."""
        located = [self._of(fault) for fault in dict.fromkeys(faults)]
        return sorted(located, key=lambda item: (item.line is not None, item.line or 0, item.column or 0))

    def _of(self, fault: Fault) -> LocatedFault:
        value = self.value(fault.path)
        message = fault.message
        shown = None if value is _ABSENT or isinstance(value, dict) else value
        for path, override in self._origins.items():
            if path[: len(fault.path)] == fault.path or fault.path[: len(path)] == path:
                in_file = fault.path in self._positions.keys and len(fault.path) < len(path)
                if not in_file:
                    if "did you mean" not in message:
                        message += self._misspelt_table(fault.path)
                    return LocatedFault(override, None, None, dotted(fault.path), shown, message)
        position_of = self._positions.of_value if fault.at_value else self._positions.of_key
        position = position_of(fault.path)
        origin = f"{self._name}:{position.line}:{position.column}"
        return LocatedFault(origin, position.line, position.column, dotted(fault.path), shown, message)

    def _misspelt_table(self, path: KeyPath) -> str:
        """Return a suggestion where an override made a table because the name of the one it meant was misspelt."""
        value, parent = self.value(path), self.value(path[:-1])
        if not isinstance(value, dict) or not isinstance(parent, dict) or not path:
            return ""
        near = nearest(str(path[-1]), [key for key in parent if key != path[-1]])
        return f'; did you mean "{dotted((*path[:-1], near))}"?' if near is not None else ""

    def value(self, path: KeyPath) -> Any:
        """Return what stands at a key; an object that is nothing else if the key is absent."""
        value: Any = self._data
        for part in path:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                return _ABSENT
        return value
