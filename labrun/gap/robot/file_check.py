"""The corrected robot on pieces of the log that its numbers were not fitted to, and what of it is worth writing.

Parameters and sizes of causes are fitted again without a part of the log, joint by joint, and the whole robot is
simulated on that part: as stated, as corrected, and as the MJCF file that is written, which MuJoCo alone loads and
steps. `labrun.gap.decide` then says of each joint which correction is better than what is stated; any other is left
out.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.effects import AttachedEffect
from labrun.errors import LabrunError
from labrun.fit import Dataset, FitTrial, Note, Problem, minimise, silent
from labrun.gap import criteria, decide, numerics
from labrun.gap.candidates import site_scales
from labrun.gap.held_out import mean_residuals
from labrun.gap.motion import smoothed
from labrun.gap.noise import of_sensor
from labrun.gap.recalibration import in_units_of, stated_problem
from labrun.gap.robot.diagnosis import OF_THE_WHOLE
from labrun.gap.robot.one_joint import OneJoint, one_joint, prescribed
from labrun.gap.robot.ranges import as_diagnosed
from labrun.gap.robot.together import IN_THE_ROBOT
from labrun.gap.saving import effects_of
from labrun.models import Model, Motion, Robot, mjcf_of, run_mjcf, simulate, suggest_substeps

_Moved = Literal["none", "free", "all"]
"""Which stated parameters are fitted beside causes: none, those of which nothing is stated, or all."""
_Simulator = Callable[[Model, Sequence[int]], list[FloatArray]]
_DIVERGED = 1e6
"""Squared error, in units of a joint's squared travel, of a simulation that diverges."""


@dataclass(frozen=True)
class Correction:
    """Parameters of a joint, those that were moved, and the causes there.

    Attributes
    ----------
    size
        Number of fitted values.
    causes
        Number of parameters among them that are causes themselves.
    """

    values: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]
    size: int
    causes: int = 0


@dataclass(frozen=True)
class CheckedJoint:
    """Errors of one joint on pieces of the log that the fit has not seen.

    Attributes
    ----------
    stated, corrected, exported
        Root mean square of measured minus simulated, in `unit`: of the file as stated, of the corrected model, and of
        the corrected MJCF in MuJoCo. Infinite where the simulation diverges.
    corrected_as, exported_as
        What of the correction is in the model and in the file: "as stated", "causes", "parameters" or both.
    """

    joint: str
    unit: str
    stated: float
    corrected: float
    exported: float
    corrected_as: str
    exported_as: str

    def to_json(self) -> dict[str, str | float | None]:
        """Return the fields by name; an infinite error is null."""
        errors = {
            "stated": self.stated, "corrected": self.corrected, "exported": self.exported,
        }  # fmt: skip
        finite = {name: value if np.isfinite(value) else None for name, value in errors.items()}
        words = {"corrected_as": self.corrected_as, "exported_as": self.exported_as}
        return {"joint": self.joint, "unit": self.unit, **finite, **words}


@dataclass(frozen=True)
class Written:
    """What of a correction is better than what is stated: parameters of the whole robot, and effects."""

    values: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]

    @property
    def of_the_whole(self) -> tuple[str, ...]:
        """What the robot as a whole has: a tilted base, a load."""
        tilted = "base_roll" in self.values or "base_pitch" in self.values
        return ("a tilted base",) * tilted + ("a load",) * ("tip_load" in self.values)

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> "Written":
        """Return what `to_json` gave."""
        return cls(stored["corrected"], effects_of(stored))

    def to_json(self) -> dict[str, Any]:
        """Return the keys ``corrected`` and ``effects`` of a diagnosis."""
        effects = [
            {
                "effect": each.effect.id,
                "kind": each.effect.kind,
                "site": each.site,
                "values": list(each.values),
            }
            for each in self.effects
        ]
        return {"corrected": dict(self.values), "effects": effects}


@dataclass(frozen=True)
class FileCheck:
    """What a corrected robot is worth on pieces of the log that its numbers were not fitted to.

    Attributes
    ----------
    pieces
        Number of pieces of the log that were withheld in turn.
    model, file
        What goes into the corrected model, and into the MJCF file: the file leaves out a correction that MJCF cannot
        express and that is worse without the rest.
    """

    joints: tuple[CheckedJoint, ...]
    pieces: int
    model: Written
    file: Written

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> "FileCheck":
        """Return what `to_json` gave."""
        joints = []
        for joint in stored["joints"]:
            errors = {
                name: np.inf if joint[name] is None else joint[name]
                for name in ("stated", "corrected", "exported")
            }
            joints.append(CheckedJoint(**{**joint, **errors}))
        written = (Written.from_json(stored[name]) for name in ("model", "file"))
        return cls(tuple(joints), stored["pieces"], *written)

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "joints": [joint.to_json() for joint in self.joints],
            "pieces": self.pieces,
            "model": self.model.to_json(),
            "file": self.file.to_json(),
        }


def check_file(
    robot: Robot, model: Model, dataset: Dataset, diagnosis: Mapping[str, Any], *, note: Note = silent
) -> FileCheck:
    """Simulate a corrected robot on pieces of the log that its numbers were not fitted to; keep what is better.

    Parameters
    ----------
    robot, model, dataset
        As they were diagnosed.
    diagnosis
        As `RobotDiagnosis.to_json` gives it, and as it is stored.

    Raises
    ------
    RequestError, FitError
        A robot or data that are not those of the diagnosis.
    """
    pieces = Pieces.of(robot, dataset, diagnosis)
    answers = {joint["joint"]: joint["diagnosis"] for joint in diagnosis["joints"]}
    around = as_diagnosed(prescribed(robot, model, pieces.dataset), diagnosis, answers)
    fitted: list[list[list[Correction]]] = []
    for index, joint in enumerate(robot.joints):
        note(f"fitting without parts of the log: {joint.name}, {index + 1} of {len(robot.joints)} joints")
        own = [effect for effect in effects_of(answers[joint.name]) if effect.effect.id not in OF_THE_WHOLE]
        released = [
            cause["effect"] for cause in answers[joint.name]["causes"] if cause["kind"] == "parameter"
        ]
        fitted.append(
            _corrections(
                one_joint(around, index), own, released, answers[joint.name]["corrected"], pieces.fold
            )
        )
    whole = _of_the_whole(model, diagnosis)
    note("simulating the stated, the corrected and the exported robot")
    checked = [
        _Check(model, pieces, fitted, whole, simulator).best()
        for simulator in (pieces.by_labrun, pieces.by_mujoco)
    ]
    stated = pieces.errors(pieces.by_mujoco, [model] * pieces.folds)
    in_model, in_file = checked
    errors = [pieces.rms(error) for error in (stated, in_model.error, in_file.error)]
    joints = tuple(
        CheckedJoint(
            joint.name,
            joint.unit,
            float(errors[0][index]),
            float(errors[1][index]),
            float(errors[2][index]),
            _words(fitted[index][in_model.choice[index]][-1]),
            _words(fitted[index][in_file.choice[index]][-1]),
        )
        for index, joint in enumerate(robot.joints)
    )
    return FileCheck(joints, len(pieces.dataset.trials), in_model.written, in_file.written)


def _words(correction: Correction) -> str:
    parts = ["causes"] * bool(correction.effects or correction.causes)
    parts += ["parameters"] * (len(correction.values) > correction.causes)
    return " and ".join(parts) or "as stated"


def _of_the_whole(model: Model, diagnosis: Mapping[str, Any]) -> Written:
    """Return the tilt, the load and the delay of all goals that a diagnosis put into the corrected model."""
    names = {name for parameters in IN_THE_ROBOT.values() for name in parameters}
    values = {name: value for name, value in diagnosis["corrected"].items() if name in names and value}
    if not any(name in values for name in ("base_roll", "base_pitch", "tip_load")):
        values = {}
    clocks = {entry["effect"] for entry in diagnosis["whole"]} & {"delay"}
    effects = tuple(effect for effect in effects_of(diagnosis) if effect.effect.id in clocks)
    return Written({name: value for name, value in values.items() if name in model_names(model)}, effects)


def model_names(model: Model) -> set[str]:
    """Return the names of a model's parameters."""
    return {parameter.name for parameter in model.parameters}


# --- fits without a part of the log ---------------------------------------------------------------------------------


def _corrections(
    joint: OneJoint,
    effects: Sequence[AttachedEffect],
    released: Sequence[str],
    corrected: Mapping[str, float],
    fold: IntArray,
) -> list[list[Correction]]:
    """Return every correction of a joint, the simplest first: fitted without each fold, then to everything.

    Parameters
    ----------
    released
        Parameters that are causes themselves: further from what is stated than their tolerance allows.
    """
    folds = int(fold.max()) + 1
    nothing = [Correction({}, (), 0)] * (folds + 1)
    problem, start = _problem(joint, effects, released, corrected)
    if problem is None:
        values = {
            parameter.name: corrected[parameter.name]
            for parameter in joint.model.parameters
            if parameter.name in corrected and corrected[parameter.name] != parameter.value
        }
        count = len(values) + sum(len(effect.values) for effect in effects)
        return [nothing, [Correction(values, tuple(effects), count)] * (folds + 1)] if count else [nothing]
    kinds: list[_Moved] = ["none", "free", "all"] if effects or released else ["free", "all"]
    corrections, moved_before = [nothing], -1
    for kind in kinds:
        moved = _variables_moved(problem, kind, released)
        if int(moved.sum()) == moved_before or not (effects or moved.any()):
            continue
        moved_before = int(moved.sum())
        withheld = [_fitted(problem, start, moved, fold != number, released) for number in range(folds)]
        corrections.append([*withheld, _fitted(problem, start, moved, fold >= 0, released)])
    return corrections


def _problem(
    joint: OneJoint,
    effects: Sequence[AttachedEffect],
    released: Sequence[str],
    corrected: Mapping[str, float],
) -> tuple[Problem | None, FloatArray]:
    """Return the problem of a joint with its causes, and where its diagnosis ended; None if it does not simulate."""
    trials = tuple(replace(trial, members=(trial.outputs,)) for trial in joint.dataset.trials)
    plain = stated_problem(joint.model, replace(joint.dataset, trials=trials))
    try:
        scales = site_scales(plain, plain.begin())
        problem = plain.with_effects(effects, [scales[effect.effect.kind, effect.site] for effect in effects])
        for parameter in joint.model.parameters:
            if parameter.name in released:
                problem = replace(problem, priors=problem.priors.releasing(parameter, criteria.FAR_OFF))
        own = np.array([corrected.get(each.name, each.value) for each in joint.model.parameters])
        values = np.concatenate([own, *(effect.values for effect in effects)])
        shared = np.clip(
            values[problem.priors.free] / problem.priors.scale, problem.priors.lower, problem.priors.upper
        )
        start = np.concatenate([shared, problem.guess(problem.parameters(shared))])
        problem = problem.refined(start)
        residual = mean_residuals(problem, start)
        return in_units_of(of_sensor(problem.data, residual), problem, start), start
    except (KeyError, LabrunError):
        return None, np.empty(0)


def _variables_moved(problem: Problem, kind: _Moved, released: Sequence[str]) -> Any:
    priors = problem.priors
    of_model = priors.free < len(problem.model.parameters)
    free = ~np.isfinite(priors.sigma)
    if kind == "all":
        return of_model
    cause = np.array([name in released for name in priors.names], dtype=bool)
    return of_model & (cause if kind == "none" else free | cause)


def _fitted(
    problem: Problem, start: FloatArray, moved: Any, seen: Any, released: Sequence[str]
) -> Correction:
    """Return the fit to the trials that are seen; parameters that may not move stay as stated."""
    priors, size = problem.priors, problem.size
    count = len(problem.model.parameters)
    stays = (priors.free < count) & ~moved
    chosen = [index for index in range(len(problem.data.trials)) if seen[index]]
    own = start[size:].reshape(len(problem.data.trials), problem.own_size)[chosen]
    shared = np.where(stays, priors.stated, start[:size])
    part = problem.part(chosen)
    end = minimise(
        part,
        np.concatenate([shared, own.ravel()]),
        lower=np.where(stays, shared, priors.lower),
        upper=np.where(stays, shared, priors.upper),
        tolerance=numerics.FIT_TOLERANCE,
        evaluations=numerics.FIT_EVALUATIONS,
        central=False,
        secant=True,
        confirmed=False,
    )
    parameters = part.parameters(end)
    names = [parameter.name for parameter in problem.model.parameters]
    values = {names[index]: float(parameters[index]) for index in priors.free[moved].tolist()}
    size = int(moved.sum() + np.sum(priors.free >= count))
    causes = sum(name in released for name in values)
    return Correction(_with_rate_gain_as_damping(problem, values), part.attached(parameters), size, causes)


def _with_rate_gain_as_damping(problem: Problem, values: dict[str, float]) -> dict[str, float]:
    """Return values in which damping has what a servo's rate gain changed by: the whole robot has their sum there."""
    stated = {parameter.name: parameter.value for parameter in problem.model.parameters}
    damping = next(name for name in stated if name.endswith("_damping"))
    for name in [name for name in values if name.endswith("_kv")]:
        values[damping] = max(values.get(damping, stated[damping]) + values.pop(name) - stated[name], 0.0)
    return values


# --- pieces of the log, and what simulations leave of them -----------------------------------------------------------


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

    def errors(self, simulator: _Simulator, models: Sequence[Model]) -> list[FloatArray]:
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


# --- which correction of each joint ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Choice:
    choice: tuple[int, ...]
    written: Written
    error: list[FloatArray]
    score: float


@dataclass(frozen=True)
class _Check:
    """The corrections of all joints in the whole robot.

    Attributes
    ----------
    fitted : joint -> correction -> fold
    whole
        What the robot as a whole has.
    """

    model: Model
    pieces: Pieces
    fitted: Sequence[Sequence[Sequence[Correction]]]
    whole: Written
    simulator: _Simulator

    def best(self) -> _Choice:
        """Return the corrections that are better by the rule than what is stated."""
        nothing = Written({}, ())
        stated = self._errors((0,) * len(self.fitted), nothing)
        without = self._chosen(nothing, stated)
        if not (self.whole.values or self.whole.effects):
            return without
        within = self._chosen(self.whole, stated)
        return within if within.score < without.score else without

    def _chosen(self, whole: Written, stated: list[FloatArray]) -> _Choice:
        before, strata = self.pieces.log_errors(stated), self.pieces.strata
        count = len(self.fitted)
        levels = max(len(corrections) for corrections in self.fitted)
        tables = [
            self.pieces.log_errors(
                self._errors(tuple(min(level, len(each) - 1) for each in self.fitted), whole)
            )
            for level in range(levels)
        ]
        choice = [0] * count
        moves_as_stated = np.mean(np.concatenate(stated), axis=0) <= 2.0 * self.pieces.floor
        for index, corrections in enumerate(self.fitted):
            if moves_as_stated[index]:
                continue  # to within one trial's noise: gain, damping and mass trade for one another there
            rows = [
                level
                for level in range(1, len(corrections))
                if decide.beats(tables[level][index], before[index], strata)
                and decide.beats(tables[level][index], tables[0][index], strata)
            ]
            if rows:
                sizes = [(corrections[row][-1].size, row) for row in rows]
                table = np.array([tables[row][index] for row in rows])
                choice[index] = rows[decide.leader(table, sizes, strata)]
        choice, errors = self._simplified(choice, whole)
        while True:
            after = self.pieces.log_errors(errors)
            gains = [decide.compare(before[index], after[index], strata) for index in range(count)]
            worse = [index for index in range(count) if decide.beats(before[index], after[index], strata)]
            dropped = [index for index in range(count) if choice[index] and not gains[index].is_better]
            kept = [index for index in range(count) if choice[index] and index not in dropped]
            if not dropped and worse and kept:
                dropped = [min(kept, key=lambda index: gains[index].mean)]
            if not dropped:
                break
            choice = [0 if index in dropped else level for index, level in enumerate(choice)]
            errors = self._errors(tuple(choice), whole)
        useless = worse or not any(gain.is_better for gain in gains)
        score = np.inf if useless and (whole.values or whole.effects) else float(np.mean(after))
        return _Choice(tuple(choice), self._written(tuple(choice), whole, -1), errors, score)

    def _simplified(self, choice: list[int], whole: Written) -> tuple[list[int], list[FloatArray]]:
        """Return the corrections without those that another joint's correction makes needless, and the errors left."""
        strata, errors = self.pieces.strata, self._errors(tuple(choice), whole)
        for index in range(len(choice)):
            for level in range(choice[index]):
                simpler = [*choice[:index], level, *choice[index + 1 :]]
                without = self._errors(tuple(simpler), whole)
                now, then = (self.pieces.log_errors(each)[index] for each in (errors, without))
                if not decide.beats(now, then, strata):
                    choice, errors = simpler, without
                    break
        return choice, errors

    def _errors(self, choice: tuple[int, ...], whole: Written) -> list[FloatArray]:
        models = []
        for number in range(self.pieces.folds):
            written = self._written(choice, whole, number)
            models.append(self.model.with_values(written.values).with_effects(written.effects))
        return self.pieces.errors(self.simulator, models)

    def _written(self, choice: tuple[int, ...], whole: Written, fold: int) -> Written:
        """Return parameters and effects of the whole robot; a mass is the mean over the joints that moved it."""
        stated = {parameter.name: parameter.value for parameter in self.model.parameters}
        message: dict[str, list[float]] = {}
        effects: list[AttachedEffect] = list(whole.effects)
        for index, level in enumerate(choice):
            correction = self.fitted[index][level][fold]
            for name, value in correction.values.items():
                if name in stated:
                    message[name] = [value]
                elif (mass := name.removesuffix("_ratio")) in stated:
                    message.setdefault(mass, []).append(value * stated[mass])
            for effect in correction.effects:
                try:
                    effect.check(self.model)
                except LabrunError:
                    continue  # of one joint's own equation: the whole robot has no such site
                effects.append(effect)
        values = {name: float(np.mean(numbers)) for name, numbers in message.items()}
        return Written(values | dict(whole.values), tuple(effects))
