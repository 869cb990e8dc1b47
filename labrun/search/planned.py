"""The conditions of an experiment: listed, a grid, or a random or Sobol design, less what `where` excludes."""

import itertools
import math
import warnings
from collections.abc import Mapping
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from labrun.errors import PlanError
from labrun.search.constraints import Constraint, constraints
from labrun.spec import Condition, Experiment, Interval, Range, Sweep, Value

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
    found: list[Condition] = []
    drawn = 0
    block = max(samples, 256)
    tried: list[NDArray[np.float64]] = []
    while len(found) < samples and drawn < _DRAWS_PER_SAMPLE * block:
        if sobol is None:
            points = rng.random((block, len(intervals)))
        else:
            with (
                warnings.catch_warnings()
            ):  # balance of a power of two does not outlive the constraints anyway
                warnings.simplefilter("ignore", UserWarning)
                points = np.asarray(sobol.random(block))
        drawn += block
        tried = [points]
        columns = _columns(intervals, lower + width * points)
        keep = np.ones(block, dtype=bool)
        for constraint in where:
            keep &= constraint.holds(columns)
        found += _rows(columns, keep)
    if len(found) < samples:
        columns = _columns(intervals, lower + width * np.concatenate(tried))
        if not found:
            _kept(columns, where, f"{len(columns[next(iter(columns))]):,} random points")
        raise PlanError(
            f"only {len(found)} of {drawn:,} random points satisfy the constraints; {samples} are wanted",
            hint="narrow the axes to where the constraints hold",
        )
    return found[:samples]


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
