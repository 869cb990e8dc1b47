"""Fits that were made of a run, as they stand in its folder ``fit``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.estimate import Estimate, rounded
from labrun.report.page import PageFigure, PageTable
from labrun.report.text import spaced

_SHOWN_ELSEWHERE = frozenset(
    {
        "parameters", "rmse", "figure", "warnings", "model", "method", "source", "fixed", "findings", "tables",
        "by_trial",
    }
)  # fmt: skip
_DEEPEST = 2
_MOST_ITEMS = 8


@dataclass(frozen=True, slots=True)
class StoredFit:
    """One fit, read leniently: whatever lies there must not cost the rest of a report.

    Attributes
    ----------
    path
        Its numbers.
    numbers
        As they were written; empty if they cannot be read.
    fault
        Why they cannot be read; empty if they can.
    picture
        PNG, if it is still there.
    """

    path: Path
    numbers: Mapping[str, Any]
    fault: str = ""
    picture: bytes | None = None

    @property
    def model(self) -> str:
        """What was fitted."""
        return str(self.numbers.get("model", self.path.stem))

    @property
    def method(self) -> str:
        """The way of fitting."""
        return str(self.numbers.get("method", ""))

    @property
    def title(self) -> str:
        """``Model hinge``, with the way of fitting where that has another name."""
        return self.model + (f", by {self.method}" if self.method not in ("", self.model) else "")

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Parameters that have a number and an interval."""
        found = {}
        for name, entry in as_table(self.numbers.get("parameters")).items():
            value: Any = as_table(entry).get("value")
            interval = as_list(as_table(entry).get("ci95"))
            if is_number(value) and len(interval) == 2 and all(is_number(end) for end in interval):
                unit = str(entry.get("unit", ""))
                found[str(name)] = Estimate(float(value), (float(interval[0]), float(interval[1])), unit)
        return found

    def sentences(self, name: str) -> list[str]:
        """Return its ``findings`` or ``warnings``."""
        return [str(one) for one in as_list(self.numbers.get(name))]


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def as_list(value: Any) -> list[Any]:
    """Return a list as it is, and anything else as none."""
    return value if isinstance(value, list) else []


def as_table(value: Any) -> dict[Any, Any]:
    """Return a table as it is, and anything else as an empty one."""
    return value if isinstance(value, dict) else {}


def fit_context(fit: StoredFit) -> Mapping[str, Any]:
    """Return what a page tells of a fit."""
    numbers = fit.numbers
    if fit.fault:
        return {"fault": f"{fit.path.name} cannot be read ({fit.fault}): labrun fit writes it anew."}
    fixed = as_table(numbers.get("fixed")).items()
    rows = [[spaced(str(name)), *_estimate(entry)] for name, entry in numbers["parameters"].items()]
    rows += [[spaced(str(name)), _short(value), "as given", ""] for name, value in fixed]
    rest = [
        [f"rms of measured - simulated, {spaced(str(name))}", _short(value)]
        for name, value in as_table(numbers.get("rmse")).items()
    ]
    for name, value in numbers.items():
        if name not in _SHOWN_ELSEWHERE:
            rest += _entries(spaced(str(name)), value, 1)
    alt = f"Measured and simulated signals of the fit of {fit.model}, and residuals"
    return {
        "fault": "",
        "title": fit.title,
        "warnings": fit.sentences("warnings"),
        "findings": fit.sentences("findings"),
        "parameters": PageTable(("parameter", "value", "95 % interval", "unit"), rows, words=(0, 3)),
        "tables": [table for entry in as_list(numbers.get("tables")) if (table := _fit_table(entry))],
        "rest": PageTable(("", ""), rest),
        "figure": None if fit.picture is None else PageFigure.of_png(fit.picture, alt),
    }


def _estimate(entry: Any) -> tuple[str, str, str]:
    if not isinstance(entry, Mapping):
        return _short(entry), "", ""
    value: Any = entry.get("value")
    unit, interval = str(entry.get("unit", "")), as_list(entry.get("ci95"))
    if not is_number(value) or len(interval) != 2 or not all(is_number(end) for end in interval):
        return _short(value), "not known", unit
    middle, low, high = rounded(Estimate(float(value), (float(interval[0]), float(interval[1])), unit))
    return middle, f"{low} to {high}", unit


def _fit_table(entry: Any) -> PageTable | None:
    """Return a table that a method has stored as it prints it; rows that are not whole are left out."""
    known = as_table(entry)
    header = tuple(str(one) for one in as_list(known.get("header")))
    rows = [[str(cell) for cell in row] for row in as_list(known.get("rows")) if isinstance(row, list)]
    whole = [row for row in rows if len(row) == len(header)]
    return PageTable(header, whole, caption=str(known.get("title", ""))) if header and whole else None


def _entries(name: str, value: Any, depth: int) -> list[list[str]]:
    """Return whatever else a method has written down, as rows of a table."""
    if isinstance(value, Mapping):
        if depth > _DEEPEST:
            return []
        parts = ((f"{name}, {spaced(str(key))}", item) for key, item in value.items())
        return [row for part, item in parts for row in _entries(part, item, depth + 1)]
    if isinstance(value, list):
        plain = len(value) <= _MOST_ITEMS and not any(isinstance(item, dict | list) for item in value)
        return [[name, ", ".join(_short(item) for item in value)]] if plain else []
    return [[name, _short(value)]]


def _short(value: Any) -> str:
    if is_number(value):
        return f"{value:.5g}"
    return "not known" if value is None else str(value)
