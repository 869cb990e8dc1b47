"""A bench whose trials are analytic functions of the condition, with noise that follows from seed and trial alone."""

from dataclasses import dataclass, field

import numpy as np

from labrun.experiment import Experiment, RepeatRule
from labrun.runner import Measurement
from labrun.store import TrialOutcome

RIG = {"devices": {"tail": {"plugin": "arduino-servo"}}}
GAIT = {"plugin": "sine", "joints": {"tail": {"offset_deg": 0, "amplitude_deg": "a", "frequency_hz": 1}}}


ONCE = RepeatRule(min=1, max=1)


class InterruptedBenchError(Exception):
    pass


@dataclass
class AnalyticBench:
    """Same `measure` as the runner's session. `stored` plays the run folder: what is in it is not run again."""

    truth: object
    noise: float = 0.0
    seed: int = 0
    repeats: RepeatRule = ONCE
    stored: dict = field(default_factory=dict)
    stop_after: int | None = None
    index: int = 0
    ran: int = 0
    conditions_seen: list = field(default_factory=list)

    def measure(self, conditions, *, role="measure", repeats=None, order="shuffled"):
        rule = repeats or self.repeats
        return [
            Measurement(condition, role, tuple(self._trial(condition, role, n) for n in range(rule.min)))
            for condition in conditions
        ]

    def _trial(self, condition, role, repeat):
        index, self.index = self.index, self.index + 1
        self.conditions_seen.append(condition)
        if index in self.stored:
            outcome = self.stored[index]
            assert (outcome.condition, outcome.role) == (dict(condition), role)
            return outcome
        if self.ran == self.stop_after:
            raise InterruptedBenchError
        self.ran += 1
        noise = np.random.default_rng((self.seed, index)).standard_normal()
        value = float(self.truth(condition) + self.noise * noise)
        self.stored[index] = TrialOutcome(index, dict(condition), repeat, role, objectives={"thrust": value})
        return self.stored[index]


def search_experiment(variables, *, goal="maximise", repeats=1, **cmaes):
    return Experiment.model_validate(
        {
            "title": "analytic",
            "kind": "cmaes",
            "rig": RIG,
            "gait": GAIT,
            "trial": {"duration_s": 1, "repeats": repeats},
            "objectives": {"thrust": {"plugin": "mean", "channel": "wrench.force_x", "goal": goal}},
            "cmaes": {"variables": variables, **cmaes},
        }
    )


def box(names, low=-10.0, high=10.0):
    return {name: {"from": low, "to": high} for name in names}
