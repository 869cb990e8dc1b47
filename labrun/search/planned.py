"""The conditions of an experiment: listed, a grid, or a random or Sobol design, less what `where` excludes.

Each may be measured at several settings, which make one value of it.
"""

import itertools
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.devices import Excess
from labrun.errors import PlanError
from labrun.experiment import (
    Combine,
    Condition,
    Experiment,
    Interval,
    Range,
    RepeatRule,
    Sweep,
    Value,
    value_text,
)
from labrun.search.constraints import Constraint, LimitExcesses, constraints
from labrun.search.leaders import Measured, Measures, Numbers
from labrun.store import Role

_LARGEST_GRID = 2_000_000
_DRAWS_PER_SAMPLE = 1000
_DESIGN_STREAM = 1
"""Tells the design's random numbers from those of other parts of a run with the same seed."""


def conditions(experiment: Experiment, seed: int = 0) -> list[Condition]:
    """Return the conditions a `run`, `sweep` or `track` experiment measures, in the file's order.

    Parameters
    ----------
    experiment
        For a search the list has one item: the point its search starts from.
    seed
        The run's seed: random and scrambled Sobol designs follow from it.

    Raises
    ------
    PlanError
        The constraints leave nothing (names the one that removed most), or the grid is absurdly large.
    """
    if experiment.search is not None:
        return [start_of_search(experiment)]
    if experiment.sweep is not None and experiment.kind not in ("run", "track"):
        return sweep_conditions(experiment.sweep, seed)
    if experiment.kind == "track" and experiment.track is not None:
        return [dict(condition) for condition in experiment.track.conditions]
    if experiment.run is not None:
        listed = experiment.run.conditions
        if isinstance(listed, list):
            return [dict(condition) for condition in listed]
        raise PlanError(
            f"the leaders of {', '.join(listed.experiments)} are not known yet",
            hint="labrun run takes them from the latest run",
        )
    raise PlanError(
        f'an experiment of kind "{experiment.kind}" has no list of conditions',
        hint="give it a table [run] or [sweep]",
    )


def start_of_search(experiment: Experiment) -> Condition:
    """Return where a search starts: each variable's `initial`, or the middle of its range."""
    if experiment.search is None:
        raise PlanError("the experiment has no search", hint="a search needs a table [cmaes] or [design]")
    return {
        name: float(
            variable.initial if variable.initial is not None else (variable.start + variable.stop) / 2
        )
        for name, variable in experiment.search.variables.items()
    }


def sweep_conditions(sweep: Sweep, seed: int) -> list[Condition]:
    """Return the conditions of a sweep: the crossed axes of a grid, or `samples` points of a space-filling design."""
    where = constraints(sweep.where, "sweep")
    if sweep.design == "grid":
        columns = _grid(sweep)
        keep = _kept(columns, where, "points of the grid")
        return _rows(columns, keep)
    return _sampled(sweep, where, seed)


def axis_values(axis: Range | list[Value]) -> list[Value]:
    """Return the points of a grid's axis, both ends included; 0.2 + 2 * 0.2 is 0.6, not 0.6000000000000001."""
    if isinstance(axis, Range):
        start, step = Decimal(repr(axis.start)), Decimal(repr(axis.step))
        return [float(start + index * step) for index in range(_points(axis))]
    return list(dict.fromkeys(float(value) if isinstance(value, int | float) else value for value in axis))


def _points(axis: Range) -> int:
    start, stop, step = (Decimal(repr(value)) for value in (axis.start, axis.stop, axis.step))
    return int((stop - start) / step) + 1


def _grid(sweep: Sweep) -> dict[str, NDArray[np.generic]]:
    crossed = {name: axis for name, axis in sweep.axes.items() if not isinstance(axis, Interval)}
    # counted before any is made: a step that is too small would fill the memory
    counts = {name: _points(axis) if isinstance(axis, Range) else len(axis) for name, axis in crossed.items()}
    size = math.prod(counts.values())
    if size > _LARGEST_GRID:
        lengths = ", ".join(f"{name}: {count:,}" for name, count in counts.items())
        raise PlanError(
            f"the grid has {size:,} points ({lengths}), more than {_LARGEST_GRID:,}",
            hint='take larger steps, or design = "sobol" with samples',
        )
    axes = {name: axis_values(axis) for name, axis in crossed.items()}
    product = list(itertools.product(*axes.values()))
    columns = {}
    for position, name in enumerate(axes):
        column = [row[position] for row in product]
        words = any(isinstance(value, str) for value in column)
        columns[name] = np.array(column, dtype=object if words else float)
    return columns


def _sampled(sweep: Sweep, where: list[Constraint], seed: int) -> list[Condition]:
    """Draw until `samples` points satisfy the constraints, so that a constraint thins nothing out."""
    from scipy.stats import qmc

    samples = sweep.samples or 0
    intervals = {name: axis for name, axis in sweep.axes.items() if isinstance(axis, Interval)}
    lower = np.array([float(axis.start) for axis in intervals.values()])
    width = np.array([float(axis.stop) - float(axis.start) for axis in intervals.values()])
    rng = np.random.default_rng(np.random.SeedSequence((seed, _DESIGN_STREAM)))
    sobol = qmc.Sobol(len(intervals), rng=rng) if sweep.design == "sobol" else None
    sampled: list[Condition] = []
    drawn = 0
    block = max(samples, 256)
    tried: list[NDArray[np.float64]] = []
    while len(sampled) < samples and drawn < _DRAWS_PER_SAMPLE * block:
        if sobol is None:
            points = rng.random((block, len(intervals)))
        else:
            # balance of a power of two does not outlive the constraints anyway
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                points = np.asarray(sobol.random(block))
        drawn += block
        tried = [points]
        columns = _columns(intervals, lower + width * points)
        keep = np.ones(block, dtype=bool)
        for constraint in where:
            keep &= constraint.holds(columns)
        sampled += _rows(columns, keep)
    if len(sampled) < samples:
        columns = _columns(intervals, lower + width * np.concatenate(tried))
        if not sampled:
            _kept(columns, where, f"{len(columns[next(iter(columns))]):,} random points")
        raise PlanError(
            f"only {len(sampled)} of {drawn:,} random points satisfy the constraints; {samples} are wanted",
            hint="narrow the axes to where the constraints hold",
        )
    return sampled[:samples]


def _columns(intervals: Mapping[str, object], points: NDArray[np.float64]) -> dict[str, NDArray[np.generic]]:
    return {name: points[:, index] for index, name in enumerate(intervals)}


def _kept(
    columns: Mapping[str, NDArray[np.generic]], where: list[Constraint], what: str
) -> NDArray[np.bool_]:
    size = len(next(iter(columns.values())))
    keep = np.ones(size, dtype=bool)
    removed: dict[str, int] = {}
    for constraint in where:
        holds = np.broadcast_to(constraint.holds(columns), (size,))
        removed[constraint.text] = int(np.count_nonzero(~holds))
        keep &= holds
    if not keep.any():
        worst = max(removed, key=lambda text: removed[text])
        raise PlanError(
            f"the constraints leave nothing: {worst!r} alone removes {removed[worst]:,} of {size:,} {what}",
            hint="widen the axes or loosen the constraint",
        )
    return keep


def _rows(columns: Mapping[str, NDArray[np.generic]], keep: NDArray[np.bool_]) -> list[Condition]:
    chosen = {name: column[keep].tolist() for name, column in columns.items()}
    return [dict(zip(chosen, row, strict=True)) for row in zip(*chosen.values(), strict=True)]


def settings_of(experiment: Experiment) -> list[Condition]:
    """Return the settings that each candidate is measured at, all combinations of `over`; one without any if none."""
    over = experiment.over
    return [dict(zip(over, values, strict=True)) for values in itertools.product(*over.values())]


def levels_of(experiment: Experiment) -> list[Condition]:
    """Return the levels that get a search of their own, all combinations of `each`; one without any if none."""
    each = experiment.each
    return [dict(zip(each, values, strict=True)) for values in itertools.product(*each.values())]


def at_settings(conditions: Sequence[Condition], settings: Sequence[Condition]) -> list[Condition]:
    """Return each condition at each of the settings, those of one condition next to each other."""
    return [{**condition, **setting} for condition in conditions for setting in settings]


def excess_at_settings(excess_of: LimitExcesses, settings: Sequence[Condition]) -> LimitExcesses:
    """Return a function that lists the limits a candidate violates at any setting."""

    def excess(condition: Condition) -> list[Excess]:
        excesses: dict[str, Excess] = {}
        for setting in at_settings([condition], settings):
            for exceeded in excess_of(setting):
                known = excesses.get(exceeded.quantity)
                if known is None or abs(exceeded.value - exceeded.bound) > abs(known.value - known.bound):
                    excesses[exceeded.quantity] = exceeded
        return list(excesses.values())

    return excess


@dataclass(frozen=True, slots=True)
class Combined:
    """The measurements of one candidate at all settings, as if they were one.

    Attributes
    ----------
    condition
        The candidate, without the settings.
    parts
        Its measurement at each setting.
    combine
        What becomes of them.
    worst_is_least
        Whether the goal is a maximum, of which the least is the worst.
    """

    condition: Condition
    parts: tuple[Measured, ...]
    combine: Combine
    worst_is_least: bool

    @property
    def outcomes(self) -> Sequence[object]:
        """Every trial at every setting, whatever its status."""
        return [outcome for part in self.parts for outcome in part.outcomes]

    def values(self, objective: str) -> FloatArray:
        """Return the combined value of each round of repeats, shape (rounds,).

        The n-th accepted trials of all settings make the n-th value; trials are independent, so that these values
        scatter as the sum (or mean) does. Of "worst" they are those of the setting with the worst mean: the worst of
        each round would be biased by the noise. None without an accepted trial at every setting.
        """
        each = [part.values(objective) for part in self.parts]
        return combined_values(each, self.combine, worst_is_least=self.worst_is_least)

    def truncation(self, objective: str) -> float:
        """Return what cut cycles may have done to the mean of the combined value."""
        each = [part.truncation(objective) for part in self.parts]
        if self.combine == "worst":
            return max(each)
        return sum(each) if self.combine == "sum" else sum(each) / len(each)

    @property
    def mountings(self) -> Numbers:
        """The mounting of each round where all settings share it; None elsewhere."""
        rounds = min(len(part.mountings) for part in self.parts)
        each = [tuple(part.mountings[:rounds]) for part in self.parts]
        return each[0] if len(set(each)) == 1 and self.combine != "worst" else (None,) * rounds


def combined_values(each: Sequence[FloatArray], combine: Combine, *, worst_is_least: bool) -> FloatArray:
    """Return the combined value of each round of repeats, from the values at every setting; see `Combined.values`."""
    if min(len(values) for values in each) == 0:
        return np.empty(0)
    if combine == "worst":
        means = [float(values.mean()) for values in each]
        return each[int(np.argmin(means) if worst_is_least else np.argmax(means))]
    rounds = np.stack([values[: min(map(len, each))] for values in each])
    return np.asarray(rounds.sum(axis=0) if combine == "sum" else rounds.mean(axis=0))


def combined_text(experiment: Experiment) -> str:
    """Return over which settings the objective is combined: ``sum over v = 0.1, 0.3, 0.6 m/s``; empty without any."""
    if experiment.goal is None or not experiment.over:
        return ""
    settings = []
    for name, values in experiment.over.items():
        *before, last = values
        shown = [*map(value_text, before), value_text(last, experiment.units.get(name, ""))]
        settings.append(f"{name} = {', '.join(shown)}")
    return f"{experiment.combine} over {' and '.join(settings)}"


class OverSettings:
    """A session that measures every candidate at all settings.

    Parameters
    ----------
    session
        What measures.
    settings
        Values that each candidate gets in turn.
    combine
        How the values of the settings become one.
    goal
        Direction of the objective; tells which is the worst.
    """

    def __init__(
        self,
        session: Measures,
        settings: Sequence[Condition],
        combine: Combine,
        goal: Literal["maximise", "minimise"],
    ) -> None:
        self._session = session
        self._settings = settings
        self._combine = combine
        self._goal = goal

    def measure(
        self,
        conditions: Sequence[Condition],
        *,
        role: Role = "measure",
        repeats: RepeatRule | None = None,
        order: Literal["shuffled", "as-listed"] = "shuffled",
    ) -> Sequence[Combined]:
        """Measure each candidate at each setting, all of them shuffled; one answer a candidate."""
        asked = at_settings(conditions, self._settings)
        measured = list(self._session.measure(asked, role=role, repeats=repeats, order=order))
        count = len(self._settings)
        return [
            Combined(
                condition,
                tuple(measured[index * count : (index + 1) * count]),
                self._combine,
                self._goal == "maximise",
            )
            for index, condition in enumerate(conditions)
        ]
