"""Values read from a table."""

import csv
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from labrun.control.protocol import Condition, FindFile
from labrun.errors import SpecError
from labrun.toml import Table, TableFaults, checked


class TableSettings(Table):
    """Keys of `table`: `points` as [time, value] pairs, or `file`, a CSV file of two columns.

    Times are s of the trial; the value is straight between two points, and held before the first and after the last.
    """

    points: Annotated[list[tuple[float, float]], Field(min_length=1)] | None = None
    file: str | None = None

    @model_validator(mode="after")
    def _ascends(self) -> "TableSettings":
        with TableFaults() as faults:
            if (self.points is None) == (self.file is None):
                faults.add(None, "give either points = [[0, 0.2], [10, 0.4]] or file")
            times = [time_s for time_s, _ in self.points or ()]
            for number, (before, after) in enumerate(pairwise(times)):
                if not before < after:
                    faults.add(
                        "points",
                        f"times ascend, and {after:g} s comes after {before:g} s (point {number + 2})",
                    )
                    break
        return self


class TableReference:
    """Points of time and value, straight between them."""

    Settings: ClassVar[type[Table]] = TableSettings

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        points = checked(TableSettings, settings).points
        if points is None:
            raise SpecError(
                "the table's file was not read", hint="load the experiment from its file, or give points"
            )
        self._time_s, self._value = np.array(points).T

    @staticmethod
    def embed(settings: Mapping[str, Any], find: FindFile) -> dict[str, Any]:
        """Return the settings with the points that their file holds."""
        file = settings.get("file")
        if not isinstance(file, str):
            return dict(settings)
        rest = {key: value for key, value in settings.items() if key != "file"}
        return {**rest, "points": _read(find(file))}

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        return float(np.interp(time_s, self._time_s, self._value))


def _read(path: Path) -> list[list[float]]:
    """Return the rows of a CSV file of time and value; a first line of names is passed over."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError) as error:
        raise SpecError(f"table {path} cannot be read: {error}") from error
    points: list[list[float]] = []
    for number, row in enumerate(rows, start=1):
        try:
            time_s, value = (float(item) for item in row)
        except ValueError as error:
            if number == 1:
                continue
            raise SpecError(
                f"table {path}, row {number}: {','.join(row)!r} is not a time and a value"
            ) from error
        points.append([time_s, value])
    return points
