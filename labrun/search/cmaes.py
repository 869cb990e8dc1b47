"""A CMA-ES search on the rig: generations of feasible candidates until a stop rule."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import PlanError, StoreError
from labrun.experiment import CmaEs, Condition, Experiment, condition_key, condition_text
from labrun.runner import Progress
from labrun.search.constraints import Violations, penalised
from labrun.search.ending import StopWatch, Verdict, judge
from labrun.search.leaders import Measured, Measures, pooled_variance
from labrun.search.planned import settings_of, start_of_search
from labrun.search.strategy import Strategy
from labrun.store import replace_durably, saving


class Judge(Protocol):
    """Tells which candidates may run (`labrun.search.Feasibility`, or a simulation of them)."""

    def of(self, conditions: Sequence[Condition]) -> Sequence[Violations]:
        """Return what each condition violates; nothing on a bench moves to find out."""
        ...


_EXPLAINED = ("restart", "population", "mean", "sigma", "covariance", "path_sigma", "path_c", "candidates")
_LEVEL_STREAM = 1
_SEARCH_STREAM = 2
"""Tells the search's random numbers from those of other parts of a run with the same seed."""


@dataclass(slots=True)
class SearchCandidate:
    """A point of the search and all that was measured there; `truncation` is what cut cycles may have done to it."""

    point: FloatArray
    condition: Condition
    violations: Violations
    values: list[float] = field(default_factory=list)
    truncation: float = 0.0
    penalised_cost: float = math.inf

    def mean(self) -> float | None:
        """Return the mean of the accepted trials; None without one."""
        return float(np.mean(self.values)) if self.values else None

    def cost(self, sign: float) -> float | None:
        """Return the cost, `sign` times the mean, at the worse end of the truncation error."""
        return sign * float(np.mean(self.values)) + self.truncation if self.values else None

    def record(self) -> dict[str, Any]:
        """Return what the generation's file says of it."""
        return {
            "condition": dict(self.condition),
            "value": self.mean(),
            "values": list(self.values),
            "feasible": self.violations.feasible,
            "violations": list(self.violations.texts),
            "violated_by": self.violations.size,
            "cost": self.penalised_cost,
        }


class NoCandidateError(PlanError):
    """A whole search found nothing that may run."""


@dataclass(frozen=True, slots=True)
class Searched:
    """All measurements of a search, and its verdict."""

    measured: list[Measured]
    verdict: Verdict


def search_by_cmaes(
    experiment: Experiment,
    session: Measures,
    folder: Path,
    *,
    feasibility: Judge,
    seed: int,
    progress: Progress,
    level: Condition | None = None,
    number: int = 0,
) -> Searched:
    """Search until a stop rule applies; return all measurements and the verdict.

    A resumed search is replayed: the session serves stored trials, every generation is computed again from the
    same random numbers, and compared with its stored state.

    Parameters
    ----------
    folder
        Where each generation's state is kept.
    feasibility
        Tells which candidates may run.
    seed
        The run's seed.
    level, number
        Of one of several searches: what stays the same in all its conditions, and its place among them.

    Raises
    ------
    NoCandidateError
        No candidate of the whole search was feasible.
    StoreError
        A replayed generation differs from the stored one.
    """
    search = _Search(experiment, session, folder, feasibility, seed, progress, level or {}, number)
    return Searched(search.measured, search.run())


@dataclass
class _Search:
    experiment: Experiment
    session: Measures
    folder: Path
    feasibility: Judge
    seed: int
    progress: Progress
    level: Condition
    number: int

    def __post_init__(self) -> None:
        goal, table = self.experiment.goal, self.experiment.search
        if table is None or goal is None:
            raise PlanError("a search needs a table [cmaes] or [design], and an objective with a goal")
        self._table: CmaEs = table
        self._objective, direction = goal
        self._sign = -1.0 if direction == "maximise" else 1.0
        # The stream of a first search is that of one alone, whatever others come after it.
        behind = (_LEVEL_STREAM, self.number) if self.number else ()
        self._stream = (self.seed, _SEARCH_STREAM, *behind)
        self._known: dict[object, SearchCandidate] = {}
        self._watch = StopWatch(self._table.stop)
        self._spreads: list[float] = []
        self._population = self._table.population_size
        self.measured: list[Measured] = []

    def run(self) -> Verdict:
        """Run the search and its restarts."""
        reason = ""
        for restart in range(self._table.restarts + 1):
            reason = self._descend(restart)
            if self._watch.over or restart == self._table.restarts:
                break
            self.progress.note(f"restart {restart + 1} with twice the population: {reason}")
        if not any(candidate.violations.feasible for candidate in self._known.values()):
            worst = min(self._known.values(), key=lambda item: (item.violations.number, item.violations.size))
            at = f" at {condition_text(self.level)}" if self.level else ""
            raise NoCandidateError(
                f"no candidate of {self._watch.generation} generations may run{at}; the nearest breaks: "
                + "; ".join(worst.violations.texts),
                hint="widen the limits or `where`, or give the variables an initial point that holds",
            )
        return judge(
            reason,
            self._spreads,
            budget_spent=self._watch.over,
            is_constant=self._is_constant(),
            goal=self._table.stop.step_size_below,
            trials=self._watch.trials,
            trials_each=self._trials_of(self._population),
            generations=self._watch.generation,
            level=self.level or None,
        )

    def _descend(self, restart: int) -> str:
        """Run one strategy until it, or the whole search, is to stop; return why."""
        # A restart's numbers follow from seed and number alone, whatever the strategies before it consumed.
        rng = np.random.default_rng(np.random.SeedSequence((*self._stream, restart)))
        strategy = self._strategy(restart, rng)
        self._population, self._spreads = strategy.population, []
        leaders: list[SearchCandidate] = []
        self._watch.restart()
        while True:
            planned = self._trials_of(strategy.population)
            if (reason := self._watch.before_generation(planned)) is not None:
                return reason
            candidates, known = self._generation(strategy, leaders)
            leaders = self._leading(candidates)
            noise = self._standard_error(candidates)
            costs = [cost for item in candidates if (cost := item.cost(self._sign)) is not None]
            self._spreads.append(strategy.largest_spread)
            reason = self._watch.after_generation(costs, noise, strategy.largest_spread)
            self._keep(strategy, restart, candidates, known)
            self._tell_progress(candidates)
            if reason is None:
                reason = strategy.exhausted()
            if reason is not None:
                return reason

    def _strategy(self, restart: int, rng: np.random.Generator) -> Strategy:
        table = self._table
        start = start_of_search(self.experiment)
        if restart == 0:
            point = np.array(
                [(float(start[k]) - v.start) / (v.stop - v.start) for k, v in table.variables.items()]
            )
        else:
            point = rng.random(len(table.variables))
        population = table.population_size
        factor = 2**restart  # IPOP: Auger & Hansen (2005), doi:10.1109/CEC.2005.1554902
        parents = None if table.parents is None else table.parents * factor
        return Strategy(point, table.step_size, population * factor, parents, rng)

    def _generation(
        self, strategy: Strategy, leaders: list[SearchCandidate]
    ) -> tuple[list[SearchCandidate], int]:
        """Draw, measure what may run, and let the strategy learn."""
        points = strategy.ask(strategy.population - len(leaders))
        conditions = [self._condition(point) for point in points]
        drawn = [
            self._known.setdefault(condition_key(condition), SearchCandidate(point, condition, violations))
            for point, condition, violations in zip(
                points, conditions, self.feasibility.of(conditions), strict=True
            )
        ]
        candidates = [*leaders, *drawn]
        feasible = [item for item in candidates if item.violations.feasible]
        self.progress.phase(
            f"generation {self._watch.generation + 1}: {len(feasible)} of {len(candidates)} candidates may run"
        )
        self._measure(feasible)
        costs = penalised(
            [item.cost(self._sign) for item in candidates],
            [item.violations for item in candidates],
            self._table.penalty,
            seen=self._watch.range_of_costs,
        )
        for item, cost in zip(candidates, costs, strict=True):
            item.penalised_cost = cost
        strategy.tell([*(item.point for item in leaders), *points], costs, known=len(leaders))
        return candidates, len(leaders)

    def _measure(self, candidates: Sequence[SearchCandidate]) -> None:
        distinct = list({id(item): item for item in candidates}.values())
        if not distinct:
            return
        measurements = self.session.measure([item.condition for item in distinct])
        for item, measurement in zip(distinct, measurements, strict=True):
            item.values += measurement.values(self._objective).tolist()
            item.truncation = measurement.truncation(self._objective) or item.truncation
        self.measured += measurements
        self._watch.trials += sum(len(measurement.outcomes) for measurement in measurements)

    def _condition(self, point: FloatArray) -> Condition:
        condition = dict(self.level)
        for (name, variable), share in zip(self._table.variables.items(), point.tolist(), strict=True):
            value = variable.start + share * (variable.stop - variable.start)
            condition[name] = float(min(max(value, variable.start), variable.stop))
        return condition

    def _leading(self, candidates: Sequence[SearchCandidate]) -> list[SearchCandidate]:
        """Return the leaders to measure again in the next generation, which averages out selection bias."""
        distinct = {id(item): item for item in candidates if item.values}
        ordered = sorted(distinct.values(), key=lambda item: item.penalised_cost)
        return ordered[: self._table.reevaluate]

    def _standard_error(self, candidates: Sequence[SearchCandidate]) -> float:
        """Return the standard error of one candidate's mean, pooled over the generation; 0 if nothing was repeated."""
        samples = [np.array(item.values) for item in candidates if item.values]
        variance = pooled_variance(samples)
        if variance is None or not samples:
            return 0.0
        return math.sqrt(variance / float(np.mean([len(values) for values in samples])))

    def _trials_of(self, population: int) -> int:
        return population * self.experiment.trial.repeats.min * len(settings_of(self.experiment))

    def _best(self) -> SearchCandidate | None:
        measured = [
            (cost, item) for item in self._known.values() if (cost := item.cost(self._sign)) is not None
        ]
        return min(measured, key=lambda pair: pair[0])[1] if measured else None

    def _is_constant(self) -> bool:
        """Tell whether all trials of at least two different candidates gave the same value, to the last bit."""
        measured = [candidate.values for candidate in self._known.values() if candidate.values]
        return len(measured) > 1 and len({value for values in measured for value in values}) == 1

    def _keep(
        self, strategy: Strategy, restart: int, candidates: Sequence[SearchCandidate], known: int
    ) -> None:
        best = self._best()
        variables = self._table.variables
        feasible = [item.violations.feasible for item in candidates[known:]]
        keep_generation(
            self.folder,
            self._watch.generation,
            {
                "generation": self._watch.generation,
                "restart": restart,
                "population": strategy.population,
                "variables": list(variables),
                **strategy.state(),
                "mean_condition": dict(self._condition(strategy.mean)),
                "largest_spread": strategy.largest_spread,
                "feasible_share": float(np.mean(feasible)) if feasible else 1.0,
                "trials": self._watch.trials,
                "best": None if best is None else {"condition": dict(best.condition), "value": best.mean()},
                "reevaluated": known,
                "candidates": [item.record() for item in candidates],
            },
        )

    def _tell_progress(self, candidates: Sequence[SearchCandidate]) -> None:
        if not any(item.violations.feasible for item in candidates):
            nearest = min(candidates, key=lambda item: (item.violations.number, item.violations.size))
            self.progress.note(
                f"generation {self._watch.generation}: no candidate may run; the nearest breaks: "
                + "; ".join(nearest.violations.texts)
            )


def generation_file(folder: Path, generation: int) -> Path:
    """Return where a generation's state stands; generations count from 1."""
    return folder / f"generation-{generation:06d}.json"


def keep_generation(folder: Path, generation: int, state: Mapping[str, Any]) -> None:
    """Store a generation's state, or check that it equals the one stored already.

    Parameters
    ----------
    folder
        The run's ``search`` folder; made if absent.
    state
        JSON-ready values.

    Raises
    ------
    StoreError
        A state of this generation is stored and differs in any bit: the search that is being replayed is not
        the one that was interrupted.
    """
    path = generation_file(folder, generation)
    text = json.dumps(state, allow_nan=False)
    if path.is_file():
        _compare(path, json.loads(text))
        return
    with saving(f"the state of generation {generation}", folder.parent):
        folder.mkdir(parents=True, exist_ok=True)
        replace_durably(path, text.encode())


def read_generations(folder: Path) -> list[dict[str, Any]]:
    """Return the states of all generations of a run, in order; empty for a run without a search."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("generation-*.json"))]


def _compare(path: Path, state: Mapping[str, Any]) -> None:
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise StoreError(
            f"{path} cannot be read: {error}", hint="delete that one file and resume: it is computed again"
        ) from error
    if stored == state:
        return
    differing = [key for key in state if stored.get(key) != state[key]]
    key = next((key for key in _EXPLAINED if key in differing), differing[0] if differing else "keys")
    raise StoreError(
        f"the resumed search does not repeat the stored one: {key} of generation {state.get('generation')} differs "
        f"from {path}",
        hint="same labrun, numpy and cma as in provenance.json? The trials are safe; a new run starts a new search",
    )
