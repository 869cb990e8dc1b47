"""Joints that are diagnosed already, in a file until the whole robot is: a run that ended early is resumed."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from labrun.effects import AttachedEffect, load_effect
from labrun.errors import LabrunError
from labrun.gap import Diagnosis
from labrun.store import replace_durably, saving

_SUFFIX = "-joints.json"
_TYPE, _TUPLE, _ARRAY, _EFFECT = "type", "tuple", "array", "effect"


class JointsDone:
    """Answers by what they depend on, those of earlier runs that ended early among them.

    Parameters
    ----------
    folder
        Where the diagnosis goes; the file stands beside it.
    """

    def __init__(self, folder: Path) -> None:
        self.file = folder.with_name(f"{folder.name}{_SUFFIX}")
        self.resumed: set[str] = set()
        self._answers: dict[str, Any] = {}
        self._earlier: dict[str, tuple[Path, Any]] = {}
        # the same log imported once more is another recording with the same questions
        for file in sorted(folder.parent.parent.glob(f"*/*{_SUFFIX}")):
            self._earlier |= {key: (file, answer) for key, answer in _read(file).items()}

    def get(self, key: str) -> Diagnosis | None:
        """Return the answer of an earlier run to the same question; None if there is none."""
        if key not in self._earlier:
            return None
        _, stored = self._earlier[key]
        try:
            answer = _restored(stored)
        except (KeyError, TypeError, ValueError, LabrunError):
            return None  # another version wrote it
        self.resumed.add(key)
        self._answers[key] = stored
        return answer if isinstance(answer, Diagnosis) else None

    def keep(self, key: str, answer: Diagnosis) -> None:
        """Write an answer beside the others."""
        self._answers[key] = _plain(answer)
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with saving(self.file.name, self.file.absolute().parent):
            replace_durably(self.file, json.dumps(self._answers).encode())

    def discard(self) -> None:
        """Remove the file, and those of earlier runs that this one resumed: the whole robot is diagnosed."""
        for file in {self.file, *(self._earlier[key][0] for key in self.resumed)}:
            file.unlink(missing_ok=True)


def _types_of(hint: Any, known: dict[str, type]) -> dict[str, type]:
    """Return the dataclasses by name that a type, or what it is made of, has as fields."""
    for part in get_args(hint):
        _types_of(part, known)
    if isinstance(hint, type) and hint is not AttachedEffect:
        _add_type(hint, known)
    return known


def _add_type(kind: type, known: dict[str, type]) -> None:
    if kind.__name__ in known or not hasattr(kind, "__dataclass_fields__"):
        return
    known[kind.__name__] = kind
    for hint in get_type_hints(kind).values():
        _types_of(hint, known)


_TYPES = _types_of(Diagnosis, {})


def _read(file: Path) -> dict[str, Any]:
    try:
        answers = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return answers if isinstance(answers, dict) else {}


def _plain(value: Any) -> Any:
    """Return a value of a diagnosis as JSON has it, with its type where JSON has none."""
    if isinstance(value, AttachedEffect):
        effect = value.effect
        return {_TYPE: _EFFECT, "of": [effect.id, effect.kind, value.site, list(value.values)]}
    if isinstance(value, np.ndarray):
        return {_TYPE: _ARRAY, "of": value.tolist(), "shape": list(value.shape)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {_TYPE: type(value).__name__, "of": fields}
    if isinstance(value, tuple):
        return {_TYPE: _TUPLE, "of": [_plain(part) for part in value]}
    if isinstance(value, Mapping):
        return {_TYPE: "dict", "of": [[key, _plain(part)] for key, part in value.items()]}
    return value.item() if isinstance(value, np.generic) else value


def _restored(stored: Any) -> Any:
    """Return what `_plain` was given. Raises KeyError, TypeError, ValueError or LabrunError: it is something else."""
    if not isinstance(stored, dict):
        return stored
    kind, content = stored[_TYPE], stored["of"]
    if kind == _EFFECT:
        name, site_kind, site, values = content
        return AttachedEffect(load_effect(name, site_kind), site, tuple(values))
    if kind == _ARRAY:
        return np.array(content, dtype=np.float64).reshape(stored["shape"])
    if kind == _TUPLE:
        return tuple(_restored(part) for part in content)
    if kind == "dict":
        return {key: _restored(part) for key, part in content}
    return _TYPES[kind](**{name: _restored(part) for name, part in content.items()})
