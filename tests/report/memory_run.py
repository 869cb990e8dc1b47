"""A run in memory: analytic objectives and traces, in the shape the store gives."""

from dataclasses import dataclass, field

import numpy as np

from labrun.experiment import Experiment
from labrun.report.findings import Findings
from labrun.search import Best, sweep_conditions, t_interval
from labrun.signals import Signals
from labrun.store import SettleSummary, TrialOutcome


@dataclass
class MemoryRun:
    outcomes: list
    name: str = "memory"
    path: object = None
    rate_hz: float = 100.0
    lost: int = 0
    traces: dict = field(default_factory=dict)
    events: list = field(default_factory=list)
    faults: list = field(default_factory=list)
    provenance: dict = field(default_factory=lambda: {"seed": 1, "dry_run": True})
    experiment_toml: str = ""

    def signals(self, index):
        outcome = self.outcomes[index]
        time_s = np.arange(0, outcome.duration_s + 0.1, 1 / self.rate_hz)
        rng = np.random.default_rng(index)
        wave = np.sin(4 * np.pi * time_s / (outcome.period_s or 1.0))
        force = (
            outcome.objectives.get("thrust", 0.0) + 0.3 * wave + 0.02 * rng.standard_normal(len(time_s)) + 1.0
        )
        kept = np.setdiff1d(np.arange(len(time_s)), 5 + 7 * np.arange(self.lost))
        time_s = time_s[kept]
        measured = Signals(
            "wrench",
            ("force_x",),
            ("N",),
            time_s,
            force[kept, None],
            {"force_x": outcome.tare["wrench.force_x"]} if outcome.tare else {},
            time_s,
            time_s,
            self.rate_hz,
            lost=self.lost,
        )
        return {"wrench": measured}

    def settle_curve(self, index):
        return None


def sweep_view(truth, axes, *, units=None, repeats=3, noise=0.02, kind="sweep", **sweep):
    """Return what is found of a finished sweep over `axes` whose thrust is `truth` of the condition."""
    table = {"axes": axes, **sweep}
    experiment = Experiment.model_validate(
        {
            "title": "Thrust of a tail in a tank",
            "kind": kind,
            "rig": {"devices": {"tail": {"plugin": "arduino-servo"}, "wrench": {"plugin": "robotiq-ft300"}}},
            "gait": {
                "plugin": "sine",
                "joints": {"tail": {"offset_deg": 0, "amplitude_deg": 10, "frequency_hz": 1}},
            },
            "trial": {"cycles": 4, "discard_cycles": 1},
            "objectives": {
                "thrust": {"plugin": "cycle-mean", "channel": "wrench.force_x", "goal": "maximise"}
            },
            "sweep": table,
            "run": {"conditions": [{"a": 1}]},
            "units": units or {},
        }
    )
    conditions = sweep_conditions(experiment.sweep, seed=1)
    rng = np.random.default_rng(0)
    outcomes = []

    def trial(condition, role, repeat):
        value = float(truth(condition) + noise * rng.standard_normal())
        outcomes.append(
            TrialOutcome(
                len(outcomes),
                dict(condition),
                repeat,
                role,
                objectives={"thrust": value},
                tare={"wrench.force_x": 1.0},
                started_s=20.0 * len(outcomes),
                duration_s=4.0,
                period_s=1.0,
                discard_cycles=1,
                settle=SettleSummary("quiet", 8.0 + repeat),
            )
        )
        return value

    for repeat in range(repeats):
        for condition in conditions:
            trial(condition, "measure", repeat)
    winner = max(conditions, key=truth)
    values = np.array([trial(winner, "confirm", n) for n in range(5)])
    best = Best(
        winner, "thrust", float(values.mean()), t_interval(values), "N", float(values.max()) + 0.03, 5
    )
    return Findings(MemoryRun(outcomes), experiment, best, finished=True)
