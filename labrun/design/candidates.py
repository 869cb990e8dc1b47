"""Simulate candidates of a search in parallel, and perturbed copies of the winner."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from labrun.design.simulator import Simulated, Simulator
from labrun.devices import Channel, Samples
from labrun.errors import LabrunError
from labrun.experiment import SIMULATION, Condition, RepeatRule, condition_key
from labrun.runner import Measurement, Progress
from labrun.search import Violations
from labrun.store import Role, RunFolder, TrialOutcome
from labrun.workers import Pool, spread

_COPY_STREAM = 0xC0B
"""Tells the random numbers of copies from those of other parts of a run with the same seed."""


class SimulationLimitError(LabrunError):
    """The requested number of candidates has been simulated."""


@dataclass(frozen=True, slots=True)
class Known:
    """The stored objective and violations of a candidate."""

    value: float | None
    violations: Violations


class Candidates:
    """Judges and measures the candidates of a search on simulations.

    Each distinct candidate is simulated once, whatever the number of workers; what a stored generation tells of is not
    simulated again. Of leaders, copies within the tolerance of every dimension are simulated and stored as trials.

    Parameters
    ----------
    simulator
        Simulates one.
    folder
        Where copies are stored as trials.
    pool
        Processes, or a cluster; None simulates in this process.
    seed
        The run's seed: copies follow from it.
    progress
        Told how it goes.
    generations
        Stored by the run so far.
    limit
        Stop, resumably, once so many candidates are simulated.
    """

    def __init__(
        self,
        simulator: Simulator,
        folder: RunFolder,
        pool: Pool | None,
        *,
        seed: int,
        progress: Progress,
        generations: Iterable[Mapping[str, Any]] = (),
        limit: int | None = None,
    ) -> None:
        self._simulator = simulator
        self._folder = folder
        self._pool = pool
        self._seed = seed
        self._progress = progress
        self._limit = limit
        goal = simulator.experiment.goal
        self._goal = "" if goal is None else goal[0]
        self._maximise = goal is not None and goal[1] == "maximise"
        self._best = -math.inf
        self._known: dict[object, Known] = {
            condition_key(candidate["condition"]): _read(candidate)
            for state in generations
            for candidate in state["candidates"]
        }
        self._stored = folder.outcomes()
        self._index = 0
        self.simulated = 0
        """Candidates that were simulated now, not taken from stored generations."""
        self.broken: dict[str, list[str]] = {}
        """Of copies, by their role: each broken constraint once for every copy that breaks it."""

    def of(self, conditions: Sequence[Condition]) -> list[Violations]:
        """Simulate candidates, and return what each violates.

        Raises
        ------
        SimulationLimitError
            Before a generation that would exceed the limit has begun.
        """
        new = {
            condition_key(condition): condition
            for condition in conditions
            if condition_key(condition) not in self._known
        }
        if new and self._limit is not None and self.simulated >= self._limit:
            raise SimulationLimitError(f"{self.simulated} candidates are simulated")
        for key, simulated in zip(new, self._all(list(new.values())), strict=True):
            self._known[key] = Known(simulated.objectives.get(self._goal), simulated.violations)
        self.simulated += len(new)
        return [self._known[condition_key(condition)].violations for condition in conditions]

    def measure(
        self,
        conditions: Sequence[Condition],
        *,
        role: Role = "measure",
        repeats: RepeatRule | None = None,
        order: Literal["shuffled", "as-listed"] = "shuffled",  # noqa: ARG002  (simulations do not drift)
    ) -> list[Measurement]:
        """Return the value of each candidate; of a leader that of every copy (roles "fresh" and "confirm")."""
        if role != "measure":
            return self._copies(conditions, role, 1 if repeats is None else repeats.max)
        return [self._measured(condition) for condition in conditions]

    def _measured(self, condition: Condition) -> Measurement:
        value = self._known[condition_key(condition)].value
        if value is None:
            return Measurement(condition, "measure", ())
        signed = value if self._maximise else -value
        if signed > self._best:
            self._best = signed
            self._progress.best(condition, value, "")
        outcome = TrialOutcome(-1, dict(condition), 0, objectives={self._goal: value})
        return Measurement(condition, "measure", (outcome,))

    def _copies(self, conditions: Sequence[Condition], role: Role, count: int) -> list[Measurement]:
        first = self._index
        wanted = [(condition, repeat) for condition in conditions for repeat in range(count)]
        built = [self._built(condition, first + index) for index, (condition, _) in enumerate(wanted)]
        self._index += len(wanted)
        outcomes: dict[int, list[TrialOutcome]] = {}
        for index, simulated in enumerate(self._all(built, keep=True)):
            condition, repeat = wanted[index]
            self.broken.setdefault(role, []).extend(simulated.violations.texts)
            outcome = self._store(first + index, condition, repeat, role, built[index], simulated)
            outcomes.setdefault(index // count, []).append(outcome)
        return [
            Measurement(condition, role, tuple(outcomes.get(index, ())))
            for index, condition in enumerate(conditions)
        ]

    def _built(self, condition: Condition, index: int) -> Condition:
        """Return a candidate with every dimension drawn uniformly within its tolerance."""
        rng = np.random.default_rng(np.random.SeedSequence((self._seed, _COPY_STREAM, index)))
        off = {
            name: tolerance * rng.uniform(-1, 1)
            for name, tolerance in self._simulator.design.dimensions.items()
        }
        return {
            name: value + off.get(name, 0.0) if isinstance(value, float) else value
            for name, value in condition.items()
        }

    def _store(
        self,
        index: int,
        condition: Condition,
        repeat: int,
        role: Role,
        built: Condition,
        simulated: Simulated,
    ) -> TrialOutcome:
        stored = self._stored.get(index)
        if stored is not None:
            return stored
        failed = not simulated.objectives
        outcome = TrialOutcome(
            index,
            dict(condition),
            repeat,
            role=role,
            status="failed" if failed else "done",
            reason="; ".join(simulated.violations.texts) if failed else "",
            duration_s=simulated.duration_s,
            objectives=dict(simulated.objectives),
            period_s=simulated.period_s,
            discard_cycles=self._simulator.experiment.trial.discard_cycles,
        )
        writer = self._folder.writer(index)
        if simulated.signals is not None:
            channels = tuple(
                Channel(name, unit)
                for name, unit in zip(simulated.signals.columns, simulated.signals.units, strict=True)
            )
            samples = Samples(simulated.signals.time_s, simulated.signals.time_s, simulated.signals.values)
            writer.append(SIMULATION, channels, simulated.signals.rate_hz, samples)
        self._folder.journal.append(
            "copy", sync=False, index=index, built=dict(built), violations=list(simulated.violations.texts)
        )
        writer.finish(outcome, None, None)
        return outcome

    def _all(self, candidates: Sequence[Condition], *, keep: bool = False) -> list[Simulated]:
        """Simulate candidates, in their order, on all workers."""
        if self._pool is None or len(candidates) < 2:
            return self._simulator(candidates, keep=keep)
        size = max(1, math.ceil(len(candidates) / self._pool.ahead))
        jobs = (
            (first, _job, (self._simulator, list(candidates[first : first + size]), keep))
            for first in range(0, len(candidates), size)
        )
        parts = dict(spread(self._pool, jobs))
        return [outcome for first in sorted(parts) for outcome in parts[first]]


def _job(simulator: Simulator, candidates: list[Condition], keep: bool) -> list[Simulated]:
    """Simulate some candidates in a worker."""
    return simulator(candidates, keep=keep)


def _read(record: Mapping[str, Any]) -> Known:
    """Read a stored candidate."""
    texts = tuple(record["violations"])
    return Known(record["value"], Violations(len(texts), float(record["violated_by"]), texts))
