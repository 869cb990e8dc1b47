"""What a trial of a CMA-ES search costs beside bare pycma, on the same objective evaluations.

    python benchmarks/cmaes.py [--generations 60] [--repeats 5]

Six variables, population 60, parents 30, as in turn-torque. The objective is the sphere about 0.3: it takes 2
us, so nearly all that is measured is overhead. Three sides, which take turns:

- bare pycma: ask, evaluate, tell, on the unit cube with pycma's own bound handling, nothing stored;
- labrun's search alone: the same strategy with two `where` constraints checked for every candidate, limits
  asked for, leaders kept, duplicates found, and the state of every generation on disk (written, fsync,
  renamed, directory fsync) so that an interrupted search resumes bit for bit; trials come from the same
  function instead of a bench;
- labrun's whole trial: a dry run of the shipped turn-torque with that search, 300 trials: simulated servos,
  sensor and arm, settling, tare, the samples of every trial durable on disk.

A time is divided by the number of objective evaluations. `where` is chosen so that every candidate is
feasible here: what does not run would cost no trial.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cma
import numpy as np
from measuring import machine, table

from labrun.experiment import Condition, Experiment
from labrun.runner import Measurement, SilentProgress
from labrun.search import search_by_cmaes
from labrun.store.trial import TrialOutcome

NAMES = tuple("abcdef")
POPULATION, PARENTS, STEP = 60, 30, 0.15
EXPERIMENT: dict[str, Any] = {
    "title": "sphere",
    "kind": "cmaes",
    "rig": {"devices": {"tail": {"plugin": "simulated-servo"}}},
    "gait": {
        "plugin": "sine",
        "joints": {"tail": {"offset_deg": 0, "amplitude_deg": "a", "frequency_hz": 1}},
    },
    "trial": {"duration_s": 1, "repeats": 1},
    "objectives": {"cost": {"plugin": "mean", "channel": "wrench.force_x", "goal": "minimise"}},
}


def sphere(values: Sequence[float]) -> float:
    """Return the objective; never worse than 6."""
    return sum((value - 0.3) ** 2 for value in values)


@dataclass
class Evaluations:
    """Stands where the runner's session would: every trial is one call of the objective."""

    count: int = 0
    outcomes: list[TrialOutcome] = field(default_factory=list)

    def measure(
        self, conditions: Sequence[Condition], *, role: Any = "measure", **_: Any
    ) -> list[Measurement]:
        return [Measurement(condition, role, (self._trial(condition, role),)) for condition in conditions]

    def _trial(self, condition: Condition, role: Any) -> TrialOutcome:
        self.count += 1
        value = sphere([float(condition[name]) for name in NAMES])
        return TrialOutcome(self.count - 1, dict(condition), 0, role, objectives={"cost": value})


def bare(generations: int, seed: int) -> tuple[float, int]:
    """Return seconds and evaluations of pycma alone."""
    rng = np.random.default_rng(seed)
    options = {
        "bounds": [[0.0] * 6, [1.0] * 6], "popsize": POPULATION, "CMA_mu": PARENTS, "verbose": -10, "verb_log": 0,
        "seed": np.nan, "randn": lambda *shape: rng.standard_normal(shape), "maxiter": np.inf,
    }  # fmt: skip
    start = time.perf_counter()
    strategy = cma.CMAEvolutionStrategy([0.7] * 6, STEP, options)
    for _ in range(generations):
        points = strategy.ask()
        strategy.tell(points, [sphere(point) for point in points])
    return time.perf_counter() - start, generations * POPULATION


def searched(generations: int, seed: int) -> tuple[float, int]:
    """Return seconds and evaluations of labrun's search."""
    search = {
        "population": POPULATION, "parents": PARENTS, "step_size": STEP, "reevaluate": 5,
        "variables": {name: {"from": 0.0, "to": 1.0, "initial": 0.7} for name in NAMES},
        "where": ["a + b <= 2", "c + d <= 2"], "stop": {"iterations": generations},
    }  # fmt: skip
    experiment = Experiment.model_validate({**EXPERIMENT, "cmaes": search})
    session = Evaluations()
    with tempfile.TemporaryDirectory() as scratch:
        start = time.perf_counter()
        search_by_cmaes(
            experiment,
            session,
            Path(scratch),
            limit_excesses=lambda _: [],
            seed=seed,
            progress=SilentProgress(),
        )
        return time.perf_counter() - start, session.count


def whole_trials(trials: int, seed: int) -> tuple[float, int]:
    """Return seconds and trials of a dry run of the shipped search; the time of a run of one trial is taken off."""

    def run(limit: int) -> float:
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as scratch:
            command = [
                "cmaes",
                "turn-torque",
                "--dry-run",
                "--seed",
                str(seed),
                "--limit",
                str(limit),
                "--json",
            ]
            done = subprocess.run(
                [sys.executable, "-m", "labrun", *command],
                cwd=scratch,
                check=True,
                capture_output=True,
                text=True,
            )
        counted = sum(json.loads(done.stdout)["trials"].values())
        if counted != limit:
            raise RuntimeError(f"{counted} trials ran, {limit} were asked for")
        return time.perf_counter() - start

    return run(trials + 1) - run(1), trials


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    bare(3, 0), searched(3, 0)
    each: dict[str, list[float]] = {"bare pycma": [], "labrun's search": [], "labrun's whole trial": []}
    for repeat in range(arguments.repeats):
        for name, (seconds, evaluations) in zip(
            each,
            (
                bare(arguments.generations, repeat),
                searched(arguments.generations, repeat),
                whole_trials(300, repeat),
            ),
            strict=True,
        ):
            each[name].append(1e6 * seconds / evaluations)
    base = statistics.median(each["bare pycma"])
    rows = [
        [name, f"{min(us):.0f}", f"{statistics.median(us):.0f}", f"{statistics.median(us) / base:.1f}"]
        for name, us in each.items()
    ]
    print(machine("labrun", "cma", "numpy"))
    print(table(["us per objective evaluation", "least", "median", "times bare pycma"], rows))
    extra = statistics.median(each["labrun's search"]) - base
    share = extra / statistics.median(each["labrun's whole trial"])
    print(f"\nThe search adds {extra:.0f} us to what pycma takes: {100 * share:.1f} % of a dry-run trial.")


if __name__ == "__main__":
    main()
