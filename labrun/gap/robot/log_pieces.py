"""A robot's log in pieces, each simulated by a model that has not seen it, in labrun or in MuJoCo."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.fit import Dataset, FitTrial
from labrun.gap import criteria, numerics
from labrun.gap.motion import smoothed
from labrun.models import Model, Motion, Robot, mjcf_of, run_mjcf, simulate, suggest_substeps

Simulator = Callable[[Model, Sequence[int]], list[FloatArray]]
"""Of a model and the numbers of some pieces: positions (n, joints) of each."""
_DIVERGED = 1e6
"""Squared error, in units of a joint's squared travel, of a simulation that diverges."""


@dataclass(frozen=True)
class Pieces:
    """A log in pieces, each of which belongs to a fold.

    Attributes
    ----------
    fold : per piece
    inputs : per piece (n, k)
        As early as they act, where the log stamps all goals late.
    begins : per piece (joints, 2)
        Position and rate of each joint where it begins.
    floor : (joints,)
        Mean square below which two predictions are the same: of the encoder's noise, and what no model is believed to.
    """

    robot: Robot
    dataset: Dataset
    fold: IntArray
    inputs: Sequence[FloatArray]
    begins: Sequence[FloatArray]
    floor: FloatArray
    travel: FloatArray

    @classmethod
    def of(cls, robot: Robot, dataset: Dataset, diagnosis: Mapping[str, Any]) -> "Pieces":
        """Cut a log into pieces."""
        trials = _cut(robot, dataset)
        conditions = [tuple(sorted(trial.condition.items())) for trial in trials]
        known = list(dict.fromkeys(conditions))
        apart = len(known) >= criteria.FILE_FOLDS
        number = [known.index(condition) for condition in conditions] if apart else range(len(trials))
        names = [signal.name for signal in dataset.outputs]
        columns = [names.index(joint.output) for joint in robot.joints]
        motions = [smoothed(trial.time_s, trial.outputs[:, columns]) for trial in trials]
        left = np.concatenate(
            [trial.outputs[:, columns] - q for trial, (q, _, _) in zip(trials, motions, strict=True)]
        )
        lead_s = sum(
            sum(entry["values"].values()) for entry in diagnosis["whole"] if entry["effect"] == "late-clock"
        )
        travel = np.std(np.concatenate([q for q, _, _ in motions]), axis=0)
        return cls(
            robot,
            replace(dataset, trials=tuple(trials)),
            np.array([index % criteria.FILE_FOLDS for index in number]),
            [_on_time(trial, dataset, lead_s) for trial in trials],
            [np.column_stack([q[0], rate[0]]) for q, rate, _ in motions],
            np.mean(np.square(left), axis=0) + (criteria.MODEL_ROUNDING * travel) ** 2,
            travel,
        )

    @property
    def folds(self) -> int:
        """Number of parts of the log that are withheld in turn."""
        return int(self.fold.max()) + 1

    @property
    def columns(self) -> list[int]:
        """Columns of the outputs that the joints are, in their order."""
        names = [signal.name for signal in self.dataset.outputs]
        return [names.index(joint.output) for joint in self.robot.joints]

    def by_labrun(self, model: Model, chosen: Sequence[int]) -> list[FloatArray]:
        """Return positions (n, joints) of some pieces, by the model that labrun integrates."""
        model = model.with_between({signal.name: signal.between for signal in self.dataset.inputs})
        runs, substeps = [], None
        for index in chosen:
            trial, (position, rate) = self.dataset.trials[index], self.begins[index].T
            state = dict(zip([signal.name for signal in self.dataset.outputs], trial.outputs[0], strict=True))
            for joint_index, joint in enumerate(self.robot.joints):
                state |= {joint.output: position[joint_index], f"{joint.output}_rate": rate[joint_index]}
            start = np.array([state.get(name, 0.0) for name in model.states])
            substeps = substeps or suggest_substeps(
                model, trial.time_s[:50], self.inputs[index][:50], initial_state=start, tolerance=1e-3,
                most=numerics.ROBOT_SUBSTEPS,
            )  # fmt: skip
            made = simulate(
                model, trial.time_s, self.inputs[index], initial_state=start, condition=trial.condition,
                substeps=substeps,
            )  # fmt: skip
            runs.append(made.outputs[:, self.columns])
        return runs

    def by_mujoco(self, model: Model, chosen: Sequence[int]) -> list[FloatArray]:
        """Return positions (n, joints) of some pieces, by the exported MJCF in MuJoCo."""
        exported = mjcf_of(model)
        names = [signal.name for signal in self.dataset.inputs]
        held = frozenset(
            actuator.name
            for actuator in self.robot.actuators
            if self.dataset.inputs[names.index(actuator.input)].between == "hold"
        )
        joints = [joint.name for joint in self.robot.joints]
        motions = []
        for index in chosen:
            trial, begin = self.dataset.trials[index], self.begins[index]
            controls = {
                actuator.name: self.inputs[index][:, names.index(actuator.input)]
                for actuator in self.robot.actuators
            }
            position, rate = (dict(zip(joints, column.tolist(), strict=True)) for column in begin.T)
            motions.append(Motion(trial.time_s, controls, held, position, rate))
        return run_mjcf(exported.xml, joints, motions)

    def errors(self, simulator: Simulator, models: Sequence[Model]) -> list[FloatArray]:
        """Return squared errors (n, joints) of every piece, each simulated by the model that has not seen its fold."""
        errors: list[FloatArray] = [np.empty(0)] * len(self.dataset.trials)
        for number, model in enumerate(models):
            chosen = np.flatnonzero(self.fold == number).tolist()
            for index, made in zip(chosen, simulator(model, chosen), strict=True):
                square = np.square(self.dataset.trials[index].outputs[:, self.columns] - made)
                most = _DIVERGED * np.square(np.maximum(self.travel, 1e-12))
                errors[index] = np.where(np.isfinite(square), np.minimum(square, most), most)
        return errors

    def rms(self, errors: Sequence[FloatArray]) -> FloatArray:
        """Return the root mean square of every joint; infinite where a simulation diverges."""
        mean = np.mean(np.concatenate(errors), axis=0)
        most = _DIVERGED * np.square(np.maximum(self.travel, 1e-12))
        diverges = np.any(np.concatenate(errors) >= most, axis=0)
        return np.where(diverges, np.inf, np.sqrt(mean))

    def log_errors(self, errors: Sequence[FloatArray]) -> FloatArray:
        """Return the log errors (joints, units) of pieces, cut into blocks of time where pieces are few."""
        blocks = max(1, int(np.ceil(criteria.ENOUGH_UNITS / len(errors))))
        units = [block for piece in errors for block in np.array_split(piece, min(blocks, len(piece)))]
        return np.log(np.array([np.mean(unit, axis=0) for unit in units]) + self.floor).T

    @property
    def strata(self) -> IntArray:
        """The number of the piece that each unit belongs to."""
        count = len(self.dataset.trials)
        blocks = max(1, int(np.ceil(criteria.ENOUGH_UNITS / count)))
        numbers = [
            [index] * min(blocks, len(trial.time_s)) for index, trial in enumerate(self.dataset.trials)
        ]
        return np.array([number for numbers_of_piece in numbers for number in numbers_of_piece])


def _on_time(trial: FitTrial, dataset: Dataset, lead_s: float) -> FloatArray:
    """Return the inputs of a trial as early as they act."""
    if not lead_s:
        return trial.inputs
    at_s, inputs = trial.time_s + lead_s, np.empty_like(trial.inputs)
    rows = np.clip(np.searchsorted(trial.time_s, at_s, side="right") - 1, 0, len(trial.time_s) - 1)
    for column, signal in enumerate(dataset.inputs):
        values = trial.inputs[:, column]
        inputs[:, column] = (
            values[rows] if signal.between == "hold" else np.interp(at_s, trial.time_s, values)
        )
    return inputs


def _cut(robot: Robot, dataset: Dataset) -> list[FitTrial]:
    """Return the trials, cut into shorter pieces where they are few or nothing holds a joint to its goal."""
    servo = all(actuator.command in ("position", "velocity") for actuator in robot.actuators)
    driven = {actuator.joint for actuator in robot.actuators}
    held = servo and all(joint.name in driven for joint in robot.joints)
    pieces = []
    wanted = int(np.ceil(2 * criteria.FILE_FOLDS / len(dataset.trials)))
    for trial in dataset.trials:
        length_s = float(trial.time_s[-1] - trial.time_s[0])
        count = wanted if held else max(wanted, round(length_s / criteria.FREE_PIECE_S))
        count = max(1, min(count, len(trial.time_s) // criteria.PIECE_SAMPLES))
        parts = np.array_split(np.arange(len(trial.time_s)), count)
        pieces += [trial.kept(slice(int(rows[0]), int(rows[-1]) + 1)) for rows in parts]
    return pieces
