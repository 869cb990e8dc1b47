"""What the rig of a recorded run could do next: its own gait, at conditions inside its limits."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from labrun.errors import LabrunError, RequestError
from labrun.experiment import (
    Condition,
    Experiment,
    condition_text,
    load_experiment,
    loads_experiment,
    resolved,
)
from labrun.fit import Dataset
from labrun.gap.next.trials import PlannedTrial, beyond, by_hand, evenly, reach, rounded, write_plan
from labrun.models import Model
from labrun.runner import MotionMaker, Plan, Planner
from labrun.store import COMMAND, Run
from labrun.toml import evaluate, names_in

_BY_HAND_S = 60.0
"""What a change by hand counts for when trials are chosen (chosen."""

_MOST = 60
"""Most trials that are looked at."""
_BASES = 4
"""Measured conditions that planned ones start from."""
_GENTLY = 0.25
"""Factor on the other numbers of a motion where one of them goes further."""
_UNSIGNED = ("Hz", "s")
"""Units of what is never below zero: a sine of negative frequency is one that begins the other way, and reads oddly."""
_FROM_ZERO_DEG = (5.0, -5.0, 15.0, -15.0)
"""Offsets that are tried where none was measured."""
_FREED = {"frequency_hz": "Hz", "amplitude_deg": "deg", "offset_deg": "deg"}
"""Keys of a sine that an experiment may hold constant, and that the next one may vary."""


@dataclass(frozen=True)
class RunBench:
    """A run's experiment, as something that further trials can be asked of.

    Attributes
    ----------
    tree
        The experiment as TOML tables, with constants of the gait that may be varied made into conditions.
    measured
        Conditions that were measured, each once.
    settle_s
        What settling took on the bench, per trial; None where it was not watched.
    step_s
        Between samples.
    joint_of
        The joint whose command stands for each input of the model.
    stands_in
        Inputs whose measured course is taken to be the commanded one.
    constraints
        What the experiment's sweep or search demands of its conditions.
    """

    name: str
    tree: dict[str, Any]
    experiment: Experiment
    model: Model
    measured: list[dict[str, float | str]]
    settle_s: float | None
    step_s: float
    joint_of: tuple[str, ...]
    stands_in: tuple[str, ...]
    constraints: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, run: Run, dataset: Dataset, model: Model, signals: Mapping[str, str], repeats: int
    ) -> "RunBench":
        """Take up a run.

        Raises
        ------
        RequestError
            Its experiment moves in a way that cannot be planned from here.
        """
        stored = loads_experiment(run.experiment_toml, run.name).experiment
        known = {key for outcome in run.outcomes for key in outcome.condition}
        measured = [trial.condition for trial in dataset.trials if known <= set(trial.condition)]
        settled = [outcome.settle.duration_s for outcome in run.outcomes if outcome.settle is not None]
        step_s = float(np.median(np.diff(dataset.trials[0].time_s)))
        settle_s = float(np.median(settled)) if settled else None
        return cls.planned(run.name, stored, measured, model, signals, repeats, step_s, settle_s)

    @classmethod
    def planned(
        cls,
        name: str,
        stored: Experiment,
        conditions: Sequence[Condition],
        model: Model,
        signals: Mapping[str, str],
        repeats: int,
        step_s: float,
        settle_s: float | None = None,
    ) -> "RunBench":
        """Take up an experiment at these conditions, whether it ran or not.

        Raises
        ------
        RequestError
            It moves in a way that cannot be planned from here.
        """
        if stored.track is not None:
            raise RequestError(
                f"{name} closes a loop: what it commands depends on what it measures, and cannot be planned ahead",
                hint="make an open-loop experiment of the same bench, and diagnose that",
            )
        tree = tomllib.loads(resolved(stored))
        constants = _free_constants(tree)
        measured = _distinct(conditions)
        measured = _distinct([{**constants, **condition} for condition in measured])
        tree["kind"] = "run"
        for key in ("sweep", "cmaes", "leaders"):
            tree.pop(key, None)
        tree["run"] = {"conditions": measured, "order": "shuffled"}
        tree["trial"]["repeats"] = {"min": repeats, "max": repeats}
        for freed in constants:
            tree.setdefault("units", {})[freed] = _FREED[freed]

        experiment = loads_experiment(tomli_w.dumps(tree), name).experiment
        joints, stands_in = _commanded(model, signals, tuple(experiment.gait.joints))
        return cls(
            name, tree, experiment, model, measured, settle_s, step_s, joints, stands_in, _constraints(stored)
        )

    def pool(self, rng: np.random.Generator) -> list[PlannedTrial]:
        """Return trials at conditions that were not measured and that stay inside every limit."""
        return self.trials(self._conditions(Planner(self.experiment), rng))

    def trials(self, conditions: Sequence[Condition]) -> list[PlannedTrial]:
        """Return trials at these conditions."""
        planner, maker = Planner(self.experiment), MotionMaker(self.experiment)
        trials = []
        for condition in conditions:
            plan = planner.plan([condition])
            motion = maker.motion(condition)
            time_s = np.arange(0.0, motion.duration_s + 0.5 * self.step_s, self.step_s)
            trajectory = motion.trajectory
            begin = trajectory.angle_rad[0].tolist()
            inputs = np.column_stack(
                [np.empty((len(time_s), 0))]
                + [
                    np.interp(
                        time_s, trajectory.time_s, trajectory.angle_rad[:, trajectory.joints.index(joint)]
                    )
                    for joint in self.joint_of
                ]
            )
            trials.append(
                PlannedTrial(
                    condition_text(condition),
                    condition,
                    time_s,
                    inputs,
                    self.time_s(plan) + plan.trials * _BY_HAND_S * self._changes(condition),
                    reach=self._reach(condition),
                    begin_rad=begin[0] if len(begin) == 1 else 0.0,
                )
            )
        return trials

    def time_s(self, plan: Plan) -> float:
        """Return the rig time of a plan, settling as it was on this bench."""
        if self.settle_s is None:
            return plan.time_s
        return plan.time_s + plan.trials * (self.settle_s - plan.settle_s)

    def plan(self, trials: Sequence[PlannedTrial]) -> Plan:
        """Return the plan of chosen trials, checked against every limit."""
        made = Planner(self.experiment).plan([dict(trial.condition) for trial in trials])
        made.require_feasible()
        return made

    def write(
        self, path: Path, trials: Sequence[PlannedTrial], remarks: Sequence[str], model: str | None
    ) -> None:
        """Write the experiment of chosen trials, and read it again as `labrun check` does.

        Parameters
        ----------
        remarks
            What the head of the file says.
        model
            Instead of the one that its ``[gap]`` names; None leaves that.

        Raises
        ------
        StoreError
            It cannot be written.
        SpecError
            What was written does not hold.
        """
        tree = self._without_defaults()
        tree["title"] = f"{tree['title']}: what tells the causes apart"
        tree["run"] = {"conditions": [dict(trial.condition) for trial in trials]}
        if model is not None:
            tree["gap"] = {**tree.get("gap", {}), "model": model}
        write_plan(path, remarks, tree)
        load_experiment(path)

    def _without_defaults(self) -> dict[str, Any]:
        """Return the experiment's tables as a person would write them: what is as it always is, left out."""
        dump: dict[str, Any] = self.experiment.model_dump(
            mode="python", by_alias=True, exclude_none=True, exclude_defaults=True
        )
        repeats = dump.get("trial", {}).get("repeats")
        if isinstance(repeats, Mapping) and repeats.get("min") == repeats.get("max"):
            dump["trial"]["repeats"] = repeats["min"]
        return dump

    @property
    def set_by_hand(self) -> tuple[str, ...]:
        """Numbers of the condition that no motion depends on: somebody at the bench sees to them."""
        moving = _names_of(self.tree["gait"]) | _names_of(self.tree["trial"])
        return tuple(
            name
            for name in self.model.conditions
            if name not in moving
            and all(isinstance(condition.get(name), float | int) for condition in self.measured)
        )

    def _conditions(self, planner: Any, rng: np.random.Generator) -> list[dict[str, float | str]]:
        moving = _names_of(self.tree["gait"]) | _names_of(self.tree["trial"])
        by_motion = [
            name
            for name in self.measured[0]
            if name in moving
            and all(isinstance(condition.get(name), float | int) for condition in self.measured)
        ]
        bases = evenly(self.measured, _BASES)
        one_way: list[dict[str, float | str]] = []
        options: dict[str, list[float]] = {}
        for name in (*by_motion, *self.set_by_hand):
            values = sorted({float(condition[name]) for condition in self.measured})
            for base in (*bases, *_gentler(bases, by_motion, name)):
                if name in by_motion:

                    def allowed(value: float, name: str = name, base: Condition = base) -> bool:
                        return self._allowed(planner, {**base, name: value})

                    # what was zero throughout has no range to go beyond
                    unmoved = [
                        offset for offset in _FROM_ZERO_DEG if name == "offset_deg" and allowed(offset)
                    ]
                    new = beyond(values, allowed) if any(values) else unmoved
                else:
                    new = by_hand(name, values)
                options.setdefault(name, []).extend(new)
                one_way += [{**base, name: value} for value in new]
        both = [_drawn(bases, options, rng) for _ in range(_MOST)] if len(options) > 1 else []
        every = _distinct([*evenly(one_way, _MOST * 2 // 3 if both else _MOST), *both])
        fresh = [
            candidate
            for candidate in every
            if candidate not in self.measured and self._allowed(planner, candidate)
        ]
        return fresh[:_MOST]

    def _changes(self, condition: Condition) -> int:
        """Return how many numbers somebody has to set otherwise than in any trial so far."""
        return sum(
            condition[name]
            not in [
                measured_condition[name] for measured_condition in self.measured if name in measured_condition
            ]
            for name in self.set_by_hand
            if name in condition
        )

    def _reach(self, condition: Condition) -> float:
        """Return how far the numbers of a condition go beyond the measured ones."""
        factor = 1.0
        for name, value in condition.items():
            measured = [
                measured_condition[name] for measured_condition in self.measured if name in measured_condition
            ]
            numbers = [float(number) for number in measured if not isinstance(number, str)]
            if not isinstance(value, str) and numbers:
                factor *= reach(float(value), numbers)
        return factor

    def _allowed(self, planner: Any, condition: Condition) -> bool:
        units = self.tree.get("units", {})
        if any(units.get(name) in _UNSIGNED and not isinstance(value, str) and value < 0
               for name, value in condition.items()):  # fmt: skip
            return False
        try:
            return self._wanted(condition) and not planner.excess_of(condition)
        except LabrunError:  # no motion comes of it
            return False

    def _wanted(self, condition: Condition) -> bool:
        """Tell whether the constraints of a sweep or a search keep a condition in."""
        return all(bool(evaluate(constraint, condition)) for constraint in self.constraints)


def _constraints(experiment: Experiment) -> tuple[str, ...]:
    """Return what keeps conditions in: a sweep's or a search's own constraints, and the ranges of a search."""
    if experiment.sweep is not None:
        return tuple(experiment.sweep.where)
    if experiment.cmaes is None:
        return ()
    ranges = [
        bound
        for name, variable in experiment.cmaes.variables.items()
        for bound in (f"{name} >= {variable.start!r}", f"{name} <= {variable.stop!r}")
    ]
    return (*experiment.cmaes.where, *ranges)


def _free_constants(tree: dict[str, Any]) -> dict[str, float]:
    """Turn constants of a sine with one joint into names of conditions, in place; return them with their values."""
    gait = tree["gait"]
    if gait["plugin"] != "sine" or len(gait["joints"]) != 1:
        return {}
    (keys,) = gait["joints"].values()
    taken = _names_of(gait)
    constants = {}
    for key in _FREED:
        value = keys.get(key, 0.0)
        if isinstance(value, float | int) and key not in taken:
            constants[key] = float(value)
            keys[key] = key
    return constants


def _commanded(
    model: Model, signals: Mapping[str, str], joints: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joint whose command drives each input, and the inputs for which it only stands in."""
    planned, stands_in = [], []
    for signal in model.inputs:
        device, _, channel = signals.get(signal.name, f"{COMMAND}.{signal.name}").partition(".")
        if channel in joints and device == COMMAND:
            planned.append(channel)
        elif channel in joints or len(joints) == 1:
            planned.append(channel if channel in joints else joints[0])
            stands_in.append(signal.name)
        else:
            raise RequestError(
                f"the model's input {signal.name!r} is {device}.{channel}, which is measured and not commanded: nobody "
                "knows beforehand what it will do",
                hint=f"drive the model by a commanded joint ({', '.join(joints)}) to plan with it",
            )
    return tuple(planned), tuple(stands_in)


def _names_of(table: Any) -> frozenset[str]:
    """Return the names that expressions anywhere in a table use."""
    if isinstance(table, Mapping):
        return frozenset().union(*(_names_of(item) for item in table.values()))
    if isinstance(table, str):
        try:
            return names_in(table)
        except LabrunError:  # a word, not an expression
            return frozenset()
    return frozenset()


def _distinct(conditions: Sequence[Condition]) -> list[dict[str, float | str]]:
    distinct: list[dict[str, float | str]] = []
    for condition in conditions:
        if dict(condition) not in distinct:
            distinct.append(dict(condition))
    return distinct


def _gentler(
    bases: Sequence[dict[str, float | str]], by_motion: Sequence[str], name: str
) -> list[dict[str, float | str]]:
    """Return a base with less of another number: how far one may go depends on that, as speed does on amplitude."""
    if name not in by_motion:
        return []
    return [
        {**bases[-1], other: rounded(_GENTLY * float(bases[-1][other]))}
        for other in by_motion
        if other != name and bases[-1][other]
    ]


def _drawn(
    bases: Sequence[dict[str, float | str]], options: Mapping[str, list[float]], rng: np.random.Generator
) -> dict[str, float | str]:
    """Return a condition with several values changed at once."""
    condition = dict(bases[int(rng.integers(len(bases)))])
    for name, values in options.items():
        if values and rng.random() < 0.8:
            condition[name] = values[int(rng.integers(len(values)))]
    return condition
