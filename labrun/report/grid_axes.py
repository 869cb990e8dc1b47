"""What varies in a sweep, as axes of a map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.report.data import Point
from labrun.report.text import value_text
from labrun.spec import Value

FloatArray = NDArray[np.float64]

_MOST_GRID_VALUES = 60


@dataclass(frozen=True)
class Axis:
    """One parameter of a sweep.

    Attributes
    ----------
    name
        Its name in the file.
    values
        Distinct values in ascending order, or words in order of appearance; of a scattered design, the
        lower edges of bins.
    is_grid
        Whether conditions sit on the values, rather than scatter between them.
    """

    name: str
    values: tuple[Value, ...]
    is_grid: bool

    @property
    def is_words(self) -> bool:
        """Whether the values are words."""
        return any(isinstance(value, str) for value in self.values)

    @property
    def edges(self) -> FloatArray:
        """Edges of the cells around the values: half way to the neighbours, shape (values + 1,)."""
        centres = np.array([self._number(value) for value in self.values])
        if len(centres) == 1:
            return np.array([centres[0] - 0.5, centres[0] + 0.5])
        middles = (centres[1:] + centres[:-1]) / 2
        return np.concatenate([[2 * centres[0] - middles[0]], middles, [2 * centres[-1] - middles[-1]]])

    def position(self, condition: Mapping[str, Value]) -> float:
        """Return where a condition lies on the axis."""
        return self._number(condition[self.name])

    def bin_of(self, condition: Mapping[str, Value]) -> int:
        """Return the number of the cell or panel a condition falls into."""
        value = condition[self.name]
        if self.is_words:
            return self.values.index(value) if value in self.values else -1
        numbers = np.array([self._number(item) for item in self.values])
        if self.is_grid:
            nearest = int(np.argmin(np.abs(numbers - float(value))))
            return nearest if np.isclose(numbers[nearest], float(value), rtol=1e-9, atol=1e-12) else -1
        return int(np.searchsorted(numbers, float(value), side="right")) - 1

    def name_of(self, number: int) -> str:
        """Return what follows the name in a panel's title: ``= 5``, or the range of a bin."""
        if self.is_grid:
            return f"= {value_text(self.values[number])}"
        if number + 1 >= len(self.values):
            return f"above {value_text(self.values[number])}"
        return f"{value_text(self.values[number])} to {value_text(self.values[number + 1])}"

    def thinned(self, most: int) -> "Axis":
        """Return an axis fit for panels: at most so many values evenly taken, or three bins of a scattered one."""
        if not self.is_grid:
            numbers = np.array([self._number(value) for value in self.values])
            return Axis(self.name, tuple(np.quantile(numbers, [0.0, 1 / 3, 2 / 3]).tolist()), is_grid=False)
        if len(self.values) <= most:
            return self
        chosen = np.unique(np.linspace(0, len(self.values) - 1, most).round().astype(int))
        return Axis(self.name, tuple(self.values[index] for index in chosen), is_grid=True)

    def ticks(self, axis: Any) -> None:
        """Set the ticks of a matplotlib axis."""
        from matplotlib.ticker import MaxNLocator

        if self.is_words:
            axis.set_ticks(range(len(self.values)), [str(value) for value in self.values])
        else:
            axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))

    def _number(self, value: Value) -> float:
        return float(self.values.index(value)) if isinstance(value, str) else float(value)


def axes_of(points: Sequence[Point]) -> list[Axis]:
    """Return what varies between conditions, in the order of the file."""
    found = []
    for name in points[0].condition if points else ():
        values = list(dict.fromkeys(point.condition[name] for point in points))
        if len(values) < 2:
            continue
        words = any(isinstance(value, str) for value in values)
        ordered = values if words else sorted(values, key=float)
        found.append(Axis(name, tuple(ordered), is_grid=words or len(values) <= _MOST_GRID_VALUES))
    if len(found) > 1 and all(len(axis.values) == len(points) for axis in found):
        return [Axis(axis.name, axis.values, is_grid=axis.is_words) for axis in found]
    return found


def most_telling(points: Sequence[Point], axes: Sequence[Axis], count: int) -> list[Axis]:
    """Return the axes along which the mean objective varies most, in the order of the file."""

    def variation(axis: Axis) -> float:
        groups: dict[object, list[float]] = {}
        for point in points:
            key = point.condition[axis.name] if axis.is_grid else axis.thinned(3).bin_of(point.condition)
            groups.setdefault(key, []).append(point.mean)
        return float(np.std([np.mean(values) for values in groups.values()]))

    chosen = sorted(axes, key=variation, reverse=True)[:count]
    return [axis for axis in axes if axis in chosen]


def best_over_others(points: Sequence[Point], axes: Sequence[Axis], *, maximise: bool) -> list[Point]:
    """Return, for each combination on these axes, the best point over all other parameters."""
    best: dict[object, Point] = {}
    for point in points:
        key = tuple(point.condition[axis.name] for axis in axes)
        known = best.get(key)
        if known is None or (point.mean > known.mean) == maximise:
            best[key] = point
    return list(best.values())
