"""Optima at the end of a range: a wider range may hold a better one, if constraints and limits leave room there."""

from collections.abc import Callable, Sequence

from labrun.errors import LabrunError
from labrun.experiment import Condition, Experiment, Interval
from labrun.search.constraints import Feasibility, LimitExcesses, constraints
from labrun.search.planned import axis_values

_NEAR = 0.01
"""A value closer to an end of its range than this share of it stands at that end."""
_BEYOND = 0.05
"""Beyond the end of a continuous range, the room that matters begins at this share of it."""
_FEWEST_LEVELS = 3
"""An axis of fewer values compares alternatives; it has no range."""


def range_end_notes(experiment: Experiment, best: Condition, excess_of: LimitExcesses) -> tuple[str, ...]:
    """Return a sentence for each variable or axis at whose end the best condition stands.

    A constraint or limit that forbids the values beyond the end is named instead of the advice to widen the range.

    Parameters
    ----------
    experiment
        A sweep or a search; of any other kind there are no ranges.
    best
        The winner.
    excess_of
        Returns which limits of the rig a condition's motion would leave, at any of the settings.
    """
    breaks = _breaks(experiment, excess_of)
    notes = []
    for name, (low, high, step) in _ranges(experiment).items():
        value = best.get(name)
        if not isinstance(value, int | float):
            continue
        for side, end, outward in (("lower", low, -1.0), ("upper", high, 1.0)):
            if abs(value - end) > _NEAR * (high - low):
                continue
            try:
                broken = breaks({**best, name: end + outward * step})
            except LabrunError as error:  # the gait cannot even be computed there
                broken = [str(error.args[0])]
            room = (
                f"nothing beyond it may run: {'; '.join(broken)}"
                if broken
                else "a wider range may hold a better one"
            )
            notes.append(f"at the {side} end of {name}: {room}")
    return tuple(notes)


def _ranges(experiment: Experiment) -> dict[str, tuple[float, float, float]]:
    """Return lower end, upper end and the step beyond either, by the name of a variable or numeric axis."""
    if experiment.search is not None:
        variables = experiment.search.variables
        return {name: _continuous(float(v.start), float(v.stop)) for name, v in variables.items()}
    ranges = {}
    for name, axis in (
        experiment.sweep.axes.items() if experiment.sweep and experiment.kind == "sweep" else ()
    ):
        if isinstance(axis, Interval):
            ranges[name] = _continuous(float(axis.start), float(axis.stop))
            continue
        values = axis_values(axis)
        if len(values) >= _FEWEST_LEVELS and all(isinstance(value, int | float) for value in values):
            numbers = sorted(float(value) for value in values)
            ranges[name] = (numbers[0], numbers[-1], numbers[-1] - numbers[-2])
    return ranges


def _continuous(low: float, high: float) -> tuple[float, float, float]:
    return low, high, _BEYOND * (high - low)


def _breaks(experiment: Experiment, excess_of: LimitExcesses) -> Callable[[Condition], Sequence[str]]:
    """Return a function that lists the constraints and limits a condition violates."""
    if experiment.search is not None:
        feasibility = Feasibility(experiment.search, excess_of)
        return lambda condition: feasibility.of([condition])[0].texts
    where = constraints([] if experiment.sweep is None else experiment.sweep.where, "sweep")

    def broken(condition: Condition) -> list[str]:
        unmet = [constraint.text for constraint in where if not constraint.holds(condition)]
        return unmet or [str(excess) for excess in excess_of(condition)]

    return broken
