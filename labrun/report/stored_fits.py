"""Fits that were made of a run, as they stand in its folder ``fit``."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.fit.estimate import Estimate

FOLDER = "fit"


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
    """

    path: Path
    numbers: Mapping[str, Any]
    fault: str = ""

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
    def figure(self) -> Path | None:
        """Its picture, if it is still there."""
        drawn = self.path.with_suffix(".png")
        return drawn if drawn.is_file() else None

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


def stored_fits(folder: Path | None) -> list[StoredFit]:
    """Return every fit in a run's folder, by name; none for a ``run.h5`` that stands alone."""
    if folder is None:
        return []
    fits = []
    for path in sorted((folder / FOLDER).glob("*.json")):
        try:
            numbers = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            fits.append(StoredFit(path, {}, str(error)))
            continue
        if isinstance(numbers, dict) and isinstance(numbers.get("parameters"), dict):
            fits.append(StoredFit(path, numbers))
    return fits


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def as_list(value: Any) -> list[Any]:
    """Return a list as it is, and anything else as none."""
    return value if isinstance(value, list) else []


def as_table(value: Any) -> dict[Any, Any]:
    """Return a table as it is, and anything else as an empty one."""
    return value if isinstance(value, dict) else {}
