"""References: the set-point of a loop over time."""

import csv
import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from labrun.control.protocol import Condition, FindFile
from labrun.errors import SpecError
from labrun.toml import Table, TableFaults, checked, evaluate


class _Keyed:
    """A reference that follows from its keys alone."""

    Settings: ClassVar[type[Table]]
    _keys: Table

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        self._keys = checked(self.Settings, settings)


class ConstantSettings(Table):
    """Key of `constant`: its value."""

    value: float


class ConstantReference(_Keyed):
    """The same value all the time."""

    Settings: ClassVar[type[Table]] = ConstantSettings
    _keys: ConstantSettings

    def __call__(self, time_s: float) -> float:  # noqa: ARG002
        """Return the value."""
        return self._keys.value


class StepSettings(Table):
    """Keys of `step`: the value before `at_s`, and from then on."""

    before: float
    after: float
    at_s: float


class StepReference(_Keyed):
    """One value before a time, another from then on."""

    Settings: ClassVar[type[Table]] = StepSettings
    _keys: StepSettings

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        return self._keys.after if time_s >= self._keys.at_s else self._keys.before


class RampSettings(Table):
    """Keys of `ramp`: `from` until `from_s`, then straight to `to`, which it reaches at `to_s` and keeps."""

    start: float = Field(alias="from")
    stop: float = Field(alias="to")
    from_s: float = 0.0
    to_s: float

    @model_validator(mode="after")
    def _ordered(self) -> "RampSettings":
        with TableFaults() as faults:
            if not self.from_s < self.to_s:
                faults.add(
                    "to_s", f"{self.to_s:g} s is not after from_s = {self.from_s:g} s", of=("from_s", "to_s")
                )
        return self


class RampReference(_Keyed):
    """A straight line between two values, held before and after it."""

    Settings: ClassVar[type[Table]] = RampSettings
    _keys: RampSettings

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        keys = self._keys
        share = (time_s - keys.from_s) / (keys.to_s - keys.from_s)
        return keys.start + min(max(share, 0.0), 1.0) * (keys.stop - keys.start)


class SineSettings(Table):
    """Keys of `sine`: ``mean + amplitude sin(2 pi t / period_s + phase)``."""

    mean: float = 0.0
    amplitude: float
    period_s: PositiveFloat
    phase_deg: float = 0.0


class SineReference(_Keyed):
    """A sine around a mean."""

    Settings: ClassVar[type[Table]] = SineSettings
    _keys: SineSettings

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        keys = self._keys
        angle = 2.0 * math.pi / keys.period_s * time_s + math.radians(keys.phase_deg)
        return keys.mean + keys.amplitude * math.sin(angle)


class HalfSineSettings(Table):
    """Keys of `half-sine`: from `low` up to `high` and back once in `period_s`."""

    low: float
    high: float
    period_s: PositiveFloat


class HalfSineReference(_Keyed):
    """``low + (high - low) |sin(pi t / period_s)|``, the reference of section 5.4 of the source.

    The source gives it as a figure only. Its amplitude (5.2), ``20 + |40 sin(2 pi 0.005 t)|`` deg, is the same wave:
    one arch takes 100 s.
    """

    Settings: ClassVar[type[Table]] = HalfSineSettings
    _keys: HalfSineSettings

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        keys = self._keys
        return keys.low + (keys.high - keys.low) * abs(math.sin(math.pi / keys.period_s * time_s))


class FormulaSettings(Table):
    """Key of `formula`: the value, an expression in ``t`` (s of the trial) and the names of the condition."""

    value: float | str


class FormulaReference:
    """A formula in ``t``."""

    Settings: ClassVar[type[Table]] = FormulaSettings
    names: ClassVar[tuple[str, ...]] = ("t",)
    expression_settings: ClassVar[tuple[str, ...]] = ("value",)

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:
        self._value = checked(FormulaSettings, settings).value
        self._names = dict(condition)

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial. Raises ExpressionError: the formula gives no finite number there."""
        return float(evaluate(self._value, {**self._names, "t": time_s}))


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
