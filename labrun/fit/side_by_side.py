"""Two runs or recordings, quantity by quantity and condition by condition."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.fit.comparison import Pair
from labrun.models import Model, simulate
from labrun.signals import Signal
from labrun.spec import condition_text
from labrun.store import COMMAND, Run, TrialOutcome, imported_channels, is_recording

Key = tuple[tuple[str, float | str], ...]


@dataclass(frozen=True)
class Side:
    """What a run or recording can be compared by.

    Numbers are a run's objectives, or the outputs of a recording whose trials are rows of a table; signals are
    everything that was recorded over time.
    """

    run: Run
    name: str

    @cached_property
    def outcomes(self) -> list[TrialOutcome]:
        """Trials that were accepted."""
        return [one for one in self.run.outcomes if one.status == "done"]

    @cached_property
    def _recorded(self) -> bool:
        return is_recording(self.run.path) or bool(imported_channels(self.run.experiment_toml))

    @cached_property
    def _is_table(self) -> bool:
        return self._recorded and all(
            len(self.run.measured(one.index)["output"]) == 1 for one in self.outcomes
        )

    @cached_property
    def numbers(self) -> dict[str, str]:
        """Names and units of its numbers."""
        if self._is_table:
            return self._channels
        units = self.run.units()
        names = dict.fromkeys(name for one in self.outcomes for name in one.objectives)
        return {name: units.get(name, "1") for name in names}

    @cached_property
    def signals(self) -> dict[str, str]:
        """Names and units of its signals."""
        return {} if self._is_table else self._channels

    @cached_property
    def _channels(self) -> dict[str, str]:
        if self._recorded:
            return dict(self.run.devices.get("output", {}))
        return {
            f"{device}.{column}": unit
            for device, columns in self.run.devices.items()
            if device != COMMAND
            for column, unit in columns.items()
        }

    @cached_property
    def names(self) -> frozenset[str]:
        """Names that the conditions of all its trials have."""
        found = [set(one.condition) for one in self.outcomes]
        return frozenset(set.intersection(*found)) if found else frozenset()

    def by_condition(self, names: Iterable[str]) -> dict[Key, list[TrialOutcome]]:
        """Return its trials by what these names are in them."""
        groups: dict[Key, list[TrialOutcome]] = {}
        wanted = sorted(names)
        for one in self.outcomes:
            groups.setdefault(tuple((name, _rounded(one.condition[name])) for name in wanted), []).append(one)
        return groups

    def number(self, name: str, outcomes: Sequence[TrialOutcome]) -> FloatArray:
        """Return one number of each trial that has it."""
        if self._is_table:
            return np.array([self.signal(name, one).values[0] for one in outcomes])
        found = [one.objectives[name] for one in outcomes if name in one.objectives]
        return np.array([value for value in found if np.isfinite(value)])

    def signal(self, name: str, outcome: TrialOutcome) -> Signal:
        """Return one signal of a trial, from its start to its end."""
        device, _, column = ("output", "", name) if self._recorded else name.partition(".")
        signal = self.run.measured(outcome.index)[device].signal(column)
        end_s = outcome.duration_s if outcome.duration_s > 0 else np.inf
        return signal if self._recorded else signal.between(-1e-3, end_s + 1e-3)


def told_apart(data: Run, other: Run) -> tuple[str, str]:
    """Return the names of two runs or recordings; those of the same experiment also by when they began."""
    if data.name != other.name:
        return data.name, other.name
    return f"{data.name} {data.identifier}", f"{other.name} {other.identifier}"


def paired(data: Run, other: Run) -> tuple[list[Pair], tuple[str, ...]]:
    """Return what two runs or recordings have in common, and what had to be left out.

    Numbers of the same name are compared where there are any, else signals of the same name (``cameras.angle`` is the
    same as a recording's ``angle``), on the times of `data`. Conditions are the same if they agree in all names that
    both have; trials of one condition are averaged.

    Raises
    ------
    RequestError
        They have no quantity or no condition in common, or conditions that the other cannot tell apart.
    """
    mine, theirs = (Side(run, name) for run, name in zip((data, other), told_apart(data, other), strict=True))
    shared = _same_conditions(mine, theirs)
    numbers = [name for name in mine.numbers if name in theirs.numbers]
    matched = [(name, name) for name in numbers] or _same_signals(mine, theirs)
    if not matched:
        raise RequestError(
            f"{mine.name} and {theirs.name} have neither a number nor a signal of the same name",
            hint=f"{mine.name} has {_named(mine)}; {theirs.name} has {_named(theirs)}",
        )
    own, others = mine.by_condition(shared), theirs.by_condition(shared)
    common = [key for key in own if key in others]
    if not common:
        raise RequestError(
            f"{mine.name} and {theirs.name} have no condition in common",
            hint=f"{mine.name} has {_some(own)}; {theirs.name} has {_some(others)}",
        )
    notes = [
        f"{count} conditions are in {name} only" if count > 1 else f"one condition is in {name} only"
        for count, name in ((len(own) - len(common), mine.name), (len(others) - len(common), theirs.name))
        if count
    ]
    pairs = []
    for first, second in matched:
        _require_same_unit(first, mine, second, theirs)
        for key in common:
            beside = _numbers_beside if numbers else _signals_beside
            found = beside(first, mine, own[key], second, theirs, others[key])
            if found is not None:
                condition = own[key][0].condition
                unit = (mine.numbers if numbers else mine.signals)[first]
                pairs.append(Pair(condition_text(condition), condition, first, unit, *found))
    if not pairs:
        raise RequestError(f"{mine.name} and {theirs.name} have no accepted trial to compare")
    return pairs, tuple(notes)


def predicted_numbers(data: Run, model: Model) -> list[Pair] | None:
    """Return a model without states beside the objectives of a run; None if it predicts anything else."""
    side = Side(data, data.name)
    outputs = [output.name for output in model.outputs]
    if model.states or model.inputs or not all(name in side.numbers for name in outputs):
        return None
    pairs = []
    for outcomes in side.by_condition(side.names).values():
        condition = outcomes[0].condition
        told = simulate(model, np.zeros(1), np.empty((1, 0)), condition=condition, substeps=1).outputs[0]
        for name, value in zip(outputs, told, strict=True):
            measured = side.number(name, outcomes)
            if len(measured):
                mean, at = np.array([np.mean(measured)]), np.zeros(1)
                unit = side.numbers[name]
                pairs.append(
                    Pair(
                        condition_text(condition),
                        condition,
                        name,
                        unit,
                        at,
                        mean,
                        np.array([value]),
                        len(measured),
                    )
                )
    return pairs or None


def _same_conditions(mine: Side, theirs: Side) -> frozenset[str]:
    """Return the names by which conditions of both are told apart."""
    for side in (mine, theirs):
        if not side.outcomes:
            raise RequestError(f"{side.name} has no accepted trial", hint="labrun show tells why")
    shared = mine.names & theirs.names
    for side, other in ((mine, theirs), (theirs, mine)):
        for outcomes in side.by_condition(shared).values():
            differing = sorted(
                name
                for name in side.names - shared
                if len({_rounded(one.condition[name]) for one in outcomes}) > 1
            )
            if differing:
                raise RequestError(
                    f"conditions of {side.name} differ in {', '.join(differing)}, "
                    f"which {other.name} does not have",
                    hint="compare data whose conditions have the same names",
                )
    return shared


def _same_signals(mine: Side, theirs: Side) -> list[tuple[str, str]]:
    found = []
    for name in mine.signals:
        last = name.rpartition(".")[2]
        alike = [one for one in theirs.signals if one == name] or [
            one
            for one in theirs.signals
            if one.rpartition(".")[2] == last and ("." not in name or "." not in one)
        ]
        if len(alike) == 1:
            found.append((name, alike[0]))
    return found


def _require_same_unit(first: str, mine: Side, second: str, theirs: Side) -> None:
    own = {**mine.signals, **mine.numbers}[first]
    other = {**theirs.signals, **theirs.numbers}[second]
    if own != other and "1" not in (own, other):
        raise RequestError(
            f"{first} of {mine.name} is in {own}, {second} of {theirs.name} in {other}",
            hint="say the same unit in both, converting the numbers of one of them",
        )


def _numbers_beside(
    first: str,
    mine: Side,
    own: Sequence[TrialOutcome],
    second: str,
    theirs: Side,
    others: Sequence[TrialOutcome],
) -> tuple[FloatArray, FloatArray, FloatArray, int] | None:
    """Return a time, what was measured and what is held against it there, and of how many trials; None without any."""
    measured, held = mine.number(first, own), theirs.number(second, others)
    if not len(measured) or not len(held):
        return None
    return np.zeros(1), np.array([np.mean(measured)]), np.array([np.mean(held)]), len(measured)


def _signals_beside(
    first: str,
    mine: Side,
    own: Sequence[TrialOutcome],
    second: str,
    theirs: Side,
    others: Sequence[TrialOutcome],
) -> tuple[FloatArray, FloatArray, FloatArray, int] | None:
    """Return the same of signals, at the times of the first one at which all of them were recorded."""
    measured = [mine.signal(first, one) for one in own]
    held = [theirs.signal(second, one) for one in others]
    start_s = max(float(one.time_s[0]) for one in (*measured, *held))
    end_s = min(float(one.time_s[-1]) for one in (*measured, *held))
    time_s = measured[0].time_s
    time_s = time_s[(time_s >= start_s) & (time_s <= end_s)]
    if not len(time_s):
        return None
    return time_s, _mean(measured, time_s), _mean(held, time_s), len(measured)


def _mean(signals: Sequence[Signal], time_s: FloatArray) -> FloatArray:
    on_base = []
    for one in signals:
        known = np.isfinite(one.values)
        on_base.append(np.interp(time_s, one.time_s[known], one.values[known]))
    return np.asarray(np.mean(on_base, axis=0))


def _rounded(value: float | str) -> float | str:
    """Return a value that is the same whoever wrote its last digits."""
    return value if isinstance(value, str) else float(f"{value:.9g}")


def _named(side: Side) -> str:
    return ", ".join([*side.numbers, *side.signals]) or "none"


def _some(groups: Mapping[Key, object], most: int = 3) -> str:
    told = [condition_text(dict(key)) or "one without names" for key in groups]
    return "; ".join(told[:most]) + (f" and {len(told) - most} more" if len(told) > most else "")
