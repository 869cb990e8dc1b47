"""A robot diagnosed by the torques in its log: inverse dynamics, candidates as columns, one rule.

Nothing is simulated. See `labrun.gap.robot.inverse_dynamics` for how motion and torque are prepared,
`labrun.gap.robot.torque_columns` for what stands in the regression, and `labrun.gap.decide` for what is a cause.
"""

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Effect, load_effect
from labrun.errors import LabrunError
from labrun.fit import Dataset, Note, silent
from labrun.gap import criteria, decide, numerics
from labrun.gap.diagnose import Options
from labrun.gap.diagnosis import (
    Cause,
    ComparedTrace,
    Diagnosis,
    Name,
    RatedCandidate,
    ResampledNumber,
    Rest,
    Rung,
    Shrinkage,
    Sizes,
    Verdict,
    effect_words,
)
from labrun.gap.robot.diagnosis import JointDiagnosis, OfTheWhole, RobotDiagnosis
from labrun.gap.robot.linear_evidence import jackknife_error
from labrun.gap.robot.torque_columns import WHOLE, Regression, regression, torque_log
from labrun.gap.robot.torque_selection import (
    COUPLED,
    FORMS,
    Candidate,
    Selected,
    Selection,
    select,
    told_together,
)
from labrun.gap.robot.torque_units import LoggedUnits, dead_channels, logged_units, refined
from labrun.models import Model, Robot, RobotJoint, identifier, robot_terms

_Step = tuple[str, Name | None, float]
"""A step of a joint's ladder: what was added, its name, and the error that is left."""
_TRIALS_SHOWN = 4
"""Trials of which courses are kept for pictures, those with the largest error first."""
_SITE_KINDS: Mapping[str, str] = {"gravity-tilt": "base", "payload": "tip"}
_PARAMETER_UNITS: Mapping[str, Mapping[str, str]] = {
    "payload": {"mass": "kg", "x": "m", "y": "m", "z": "m"},
    "gravity-tilt": {"roll": "rad", "pitch": "rad"},
}


@dataclass(frozen=True)
class TorqueAnswer:
    """What the torques of a log say.

    Attributes
    ----------
    selection
        The causes, with the regression that they stand in.
    values : (columns,)
        Coefficients of the final model.
    drawn : (draws, columns)
        The same from resampled units and redrawn stated values.
    units
        How the logged torques were read.
    remarks
        What to know, in sentences.
    """

    selection: Selection
    values: FloatArray
    drawn: FloatArray
    units: LoggedUnits
    remarks: tuple[str, ...]


def explain_torques(
    robot: Robot, dataset: Dataset, *, withhold: Collection[str] = (), seed: int = 0, note: Note = silent
) -> TorqueAnswer:
    """Find what the torques of a log have beyond what the robot as stated asks for.

    Parameters
    ----------
    withhold
        Ids of effects that are not candidates.
    """
    rng = np.random.default_rng(seed)
    note("differentiating the motion, and choosing the low pass of both sides of the torque equation")
    log = torque_log(robot, robot_terms(robot.xml, [joint.name for joint in robot.joints]), dataset)
    note("finding the unit and the sign of every joint's torque")
    data = regression(log)
    units = logged_units(data, log.currents)
    if not units.as_logged:
        units = refined(units, regression(log.scaled(units.factors)))
        log = log.scaled(units.factors)
        data = regression(log)
    library = _library(withhold)
    note("looking for causes at all joints together")
    selection = select(data, library, rng, _scales(data, units))
    if "cogging" in library:
        periodic = log.with_periods(data.residual(selection.evidence.fit(selection.active)))
        if periodic.own_columns != log.own_columns:
            note("looking for forces that are periodic in the position")
            data = regression(periodic)
            selection = select(data, library, rng, _scales(data, units))
    note("resampling the units of evidence")
    evidence, active = selection.evidence, selection.active
    values = evidence.fit(active)
    drawn = np.zeros((numerics.RESAMPLES, len(values)))
    draws = decide.resamples(np.zeros(evidence.units, dtype=np.int64), numerics.RESAMPLES, rng)
    drawn[:, active] = evidence.resampled(active, draws, rng)
    remarks = (
        *dead_channels(log.joints, log.dead),
        *(
            f"{name} does not move: nothing can be said of it"
            for joint, name in enumerate(log.joints)
            if joint not in data.looked_at and not log.dead[joint]
        ),
        log.cut.sentence,
    )
    return TorqueAnswer(selection, values, drawn, units, remarks)


def _library(withhold: Collection[str]) -> set[str]:
    """Return the effects that may be causes: those of the regression that the library of effects has."""
    names = {(effect.removeprefix(COUPLED), "joint") for effect, _, _ in FORMS}
    names |= {("payload", "tip"), ("gravity-tilt", "base")}
    library = set()
    for name, kind in names - {(name, kind) for name, kind in names if name in withhold}:
        try:
            load_effect(name, kind)  # type: ignore[arg-type]
        except LabrunError:
            continue
        library.add(name)
    return library


def _scales(data: Regression, units: LoggedUnits) -> list[int]:
    return [int(location) for joint in units.unknown for location in data.columns_of("scale", joint)]


def diagnose_torques(
    robot: Robot, model: Model, dataset: Dataset, options: Options | None = None, *, note: Note = silent
) -> RobotDiagnosis:
    """Say of every joint what its logged torque has beyond what the robot as stated asks for.

    Parameters
    ----------
    robot
        Its drives are all told torques (see `Robot.is_told_torques`), and the log has the angle of every joint.
    model
        The model of the whole robot, into which the causes go.
    """
    options = options or Options()
    start = time.perf_counter()
    answer = explain_torques(robot, dataset, withhold=options.withhold, seed=options.seed, note=note)
    return _Telling(robot, model, dataset, options.seed, answer).whole(start)


@dataclass(frozen=True)
class _Telling:
    """An answer in the types that every diagnosis of a robot has."""

    robot: Robot
    model: Model
    dataset: Dataset
    seed: int
    answer: TorqueAnswer

    @property
    def data(self) -> Regression:
        return self.answer.selection.regression

    @property
    def causes(self) -> list[Selected]:
        """The causes, each in its richest form."""
        return told_together(self.answer.selection.causes)

    def whole(self, start: float) -> RobotDiagnosis:
        of_robot = [cause for cause in self.causes if cause.candidate.joint == WHOLE]
        causes = tuple(self.cause(cause) for cause in of_robot)
        joints = tuple(self.joint(index, joint) for index, joint in enumerate(self.robot.joints))
        effects, left = [], []
        for cause in self.causes:
            attached = self.attached(cause.candidate)
            if attached is not None:
                effects.append(attached)
            elif cause.candidate.joint != WHOLE:
                left.append(
                    f"{self.words(cause.candidate)} is not in the corrected model: it acts on two joints"
                )
        corrected = dict(self.corrected(of_robot))
        left += [
            f"the load on {cause.candidate.site} is not in the corrected model, which has one on the last body only"
            for cause in of_robot
            if cause.candidate.effect == "payload" and cause.candidate.detail != self.data.log.regressor.tip
        ]
        wholes: list[OfTheWhole] = [
            (
                whole_cause.candidate.effect,
                tuple(
                    self.data.log.joints[self.data.looked_at[number]]
                    for number in whole_cause.candidate.scope
                ),
                {name: value.value for name, value in cause.values.items()},
            )
            for whole_cause, cause in zip(of_robot, causes, strict=True)
        ]
        headline = [
            *(sentence for sentence in self.answer.units.sentences),
            *(self.load_words(cause) for cause in causes if cause.name.effect == "payload"),
            *(self.tilt_words(cause) for cause in causes if cause.name.effect == "gravity-tilt"),
        ]
        return RobotDiagnosis(
            self.robot.name, self.model.name, str(self.dataset.source), joints, tuple(wholes), tuple(effects),
            corrected, (*self.answer.remarks, *left), time.perf_counter() - start, tuple(headline), causes,
            self.input_factors(),
        )  # fmt: skip

    def input_factors(self) -> dict[str, float]:
        """Return what logged inputs are multiplied by to be those of the model, where that is not 1."""
        terms = robot_terms(self.robot.xml, list(self.data.log.joints))
        factors = {}
        for drive in self.robot.actuators:
            joint = self.data.log.joints.index(drive.joint)
            factor = float(self.answer.units.factors[joint])
            if joint in self.data.log.currents:
                factor /= terms.drives[drive.joint].gear or 1.0
            if factor != 1.0:
                factors[drive.input] = factor
        return factors

    def words(self, candidate: Candidate) -> str:
        """Return what a candidate is called, and where."""
        return f"{effect_words(candidate.effect.removeprefix(COUPLED))} at {candidate.site}"

    def load_words(self, cause: Cause) -> str:
        """Return a load, or what is missing, as a sentence without an end."""
        mass = cause.values["mass"]
        body = cause.name.site
        stated = float(self.data.log.regressor.masses[self.data.log.regressor.bodies.index(body)])
        if mass.value < 0.0:
            if mass.low <= -stated <= mass.high:
                return f"the log was made without the {body} of the file ({mass.value:.2g} kg)"
            return f"{body} is lighter than the file states ({mass.value:.2g} kg)"
        if "x" not in cause.values:
            return f"the robot carries {mass.value:.2g} kg at {body}"
        text = ", ".join(f"{cause.values[axis].value:.2g}" for axis in "xyz")
        return f"the robot carries {mass.value:.2g} kg at ({text}) m of {body}"

    def tilt_words(self, cause: Cause) -> str:
        """Return a tilt as a sentence without an end."""
        roll, pitch = (cause.values[axis].value for axis in ("roll", "pitch"))
        return f"the base is tilted by {roll:.2g} rad (roll) and {pitch:.2g} rad (pitch)"

    def shares(self, selected: Selected) -> tuple[float, float]:
        """Return the share of its joints' error that a cause closes in its turn, and that comes back without it."""
        selection, scope = self.answer.selection, list(selected.candidate.scope)

        def error(squares: FloatArray) -> float:
            return float(np.sqrt(np.nanmean(squares[..., scope])))

        gap = error(selection.recalibrated)
        if not gap > 0.0:
            return 0.0, 0.0
        before = gap
        for cause, errors in zip(selection.causes, selection.ladder, strict=True):
            after = error(np.square(errors))
            if cause.candidate == selected.candidate:
                return (before - after) / gap, (selected.without - 1.0) * error(selection.after) / gap
            before = after
        return 0.0, 0.0

    def cause(self, selected: Selected) -> Cause:
        candidate = selected.candidate
        rivals = tuple(self.name(rival) for rival in selected.rivals)
        remark = ""
        if candidate.effect.startswith(COUPLED):
            other = self.data.log.joints[self.data.log.regressor.before[candidate.joint]]
            way = "plus" if candidate.detail > 0.0 else "minus"
            remark = f"of a motor that turns by {candidate.site} {way} {other}: it acts on both joints"
        closes, returns = self.shares(selected)
        return Cause(
            self.name(candidate),
            selected.wins,
            self.sizes(candidate),
            closes,
            returns,
            rivals,
            remark=remark,
        )

    def name(self, candidate: Candidate) -> Name:
        site = identifier(candidate.site) if candidate.joint != WHOLE else candidate.site
        return Name(candidate.effect.removeprefix(COUPLED), site)

    def sizes(self, candidate: Candidate) -> dict[str, ResampledNumber]:
        """Return the parameters of a cause with their 95 % intervals."""
        best = dict(self.parameters(candidate, self.answer.values))
        drawn: dict[str, list[float]] = {name: [] for name in best}
        for row in self.answer.drawn:
            for name, value in self.parameters(candidate, row):
                drawn[name].append(value)
        units = self.parameter_units(candidate)
        ends = {name: np.percentile(values, [2.5, 97.5]) for name, values in drawn.items()}
        sizes = {
            name: ResampledNumber(
                value, float(min(ends[name][0], value)), float(max(ends[name][1], value)), units[name]
            )
            for name, value in best.items()
        }
        if "x" in sizes and sizes["mass"].low <= 0.0 <= sizes["mass"].high:
            return {"mass": sizes["mass"]}  # of a load that may weigh nothing the place is none
        return sizes

    def parameters(self, candidate: Candidate, values: FloatArray) -> Iterator[tuple[str, float]]:
        """Yield the effect's parameters from the coefficients of all columns."""
        effect = candidate.effect.removeprefix(COUPLED)
        if effect == "payload":
            mass, *moment = self.data.deviation(values, [int(candidate.detail)])[int(candidate.detail), :4]
            yield "mass", float(mass)
            for axis, first in zip("xyz", moment, strict=True):
                yield axis, float(first / mass) if mass else 0.0
            return
        if effect == "gravity-tilt":
            roll, pitch = (float(values[location]) for location in self.data.columns_of("tilt"))
            yield from (("roll", roll), ("pitch", pitch))
            return
        own = {
            (column.kind, column.phase): float(values[number])
            for number in candidate.columns
            for column in (self.data.columns[number],)
        }
        first = next(iter(own.values()))
        if effect in ("asymmetric-friction", "stribeck-friction"):
            torque = own["coulomb", 0]
            ratio = own["asymmetry" if effect == "asymmetric-friction" else "stribeck", 0]
            yield "torque", torque
            yield (
                "asymmetry" if effect == "asymmetric-friction" else "static_excess",
                ratio / torque if torque else 0.0,
            )
            if effect == "stribeck-friction":
                yield "stribeck_speed", candidate.detail
        elif effect == "cogging":
            yield from (
                ("periods", candidate.detail),
                ("sine", own["cogging", 0]),
                ("cosine", own["cogging", 1]),
            )
        elif effect == "constant-force":
            yield "force", -first
        elif effect == "drive-gain":
            yield "error", 1.0 / (1.0 + first) - 1.0 if first != -1.0 else 0.0
        else:
            yield _ONLY[effect], first

    def parameter_units(self, candidate: Candidate) -> Mapping[str, str]:
        effect = candidate.effect.removeprefix(COUPLED)
        if effect in _PARAMETER_UNITS:
            return _PARAMETER_UNITS[effect]
        unit = self.robot.joints[candidate.joint].unit
        return {parameter.name: parameter.unit(unit) for parameter in _effect(effect).parameters}

    def attached(self, candidate: Candidate) -> AttachedEffect | None:
        """Return a joint's cause as an effect at its site; None where the model has no place for it."""
        if candidate.joint == WHOLE or candidate.effect.startswith(COUPLED):
            return None
        effect = _effect(candidate.effect)
        values = dict(self.parameters(candidate, self.answer.values))
        if any(parameter.name == "transition_speed" for parameter in effect.parameters):
            values["transition_speed"] = float(self.data.log.sign_speed[candidate.joint])
        attached = effect.attach(self.robot.joints[candidate.joint].output, None, **values)
        try:
            attached.check(self.model)
        except LabrunError:
            return None
        return attached

    def corrected(self, of_robot: Sequence[Selected]) -> Iterator[tuple[str, float]]:
        """Yield the parameters of the whole robot that a load, a tilt, or a stated damping of another size changes."""
        known = {parameter.name for parameter in self.model.parameters}
        for selected in of_robot:
            values = dict(self.parameters(selected.candidate, self.answer.values))
            if selected.candidate.effect == "gravity-tilt":
                names = {"base_roll": values["roll"], "base_pitch": values["pitch"]}
            elif selected.candidate.detail == self.data.log.regressor.tip:
                names = {"tip_load": values["mass"], **{f"tip_load_{axis}": values[axis] for axis in "xyz"}}
            else:
                continue
            yield from ((name, value) for name, value in names.items() if name in known)
        terms = robot_terms(self.robot.xml, list(self.data.log.joints))
        for index, column in enumerate(self.data.columns):
            if column.kind == "damping" and f"{self.robot.joints[column.joint].output}_damping" in known:
                value = terms.damping[column.joint] + float(self.answer.values[index])
                yield f"{self.robot.joints[column.joint].output}_damping", max(value, 0.0)

    def joint(self, joint_index: int, joint: RobotJoint) -> JointDiagnosis:
        """Return what was found about one joint."""
        data, selection = self.data, self.answer.selection
        unit = self.answer.units.unit(self.data.log, joint_index)
        own = [cause for cause in self.causes if cause.candidate.joint == joint_index]
        if joint_index not in data.looked_at:
            nothing = self.diagnosis(joint, unit, (), np.full(3, np.nan), 1.0, own, joint_index)
            return JointDiagnosis(joint, nothing, np.nan, np.nan, np.nan, {}, unit)
        number = data.looked_at.index(joint_index)
        errors = np.array(
            [
                float(np.sqrt(np.nanmean(table[:, number])))
                for table in (selection.stated, selection.recalibrated, selection.after)
            ]
        )
        noise = self.noise(joint_index)
        steps: list[_Step] = [("as stated", None, errors[0]), ("recalibrated", None, errors[1])]
        last = errors[1]
        for cause, ladder in zip(selection.causes, selection.ladder, strict=True):
            shown = cause.candidate.joint == joint_index or (
                number in cause.candidate.scope and abs(np.log(last / ladder[number])) > criteria.MARGIN
            )
            if shown:
                name = self.name(cause.candidate)
                steps.append((f"+ {effect_words(name.effect)}", name, float(ladder[number])))
                last = float(ladder[number])
        diagnosis = self.diagnosis(joint, unit, steps, errors, noise, own, joint_index)
        stated, recalibrated, after = map(float, errors)
        return JointDiagnosis(joint, diagnosis, stated, recalibrated, after, {}, unit)

    def noise(self, joint_index: int) -> float:
        """Return the deviation of what changes from row to row in what is left of a joint's torque."""
        left = self.data.residual(self.answer.values)[joint_index]
        steps = np.concatenate([np.diff(residual) for residual in left])
        return max(float(np.sqrt(0.5 * np.mean(np.square(steps)))), 1e-12) if len(steps) else 1e-12

    def diagnosis(
        self, joint: RobotJoint, unit: str, steps: Sequence[_Step], errors: FloatArray, noise: float,
        own: Sequence[Selected], joint_index: int,
    ) -> Diagnosis:  # fmt: skip
        """Return a joint's diagnosis: the one place where that type is made here."""
        log = self.data.log
        causes = tuple(self.cause(selected) for selected in own)
        gap, rest = (float(np.sqrt(max(error**2 - noise**2, 0.0))) for error in errors[1:])
        closed = 1.0 - rest / gap if gap > 0.0 else 0.0
        verdict: Verdict
        if not steps:
            verdict, sentence = (
                "cannot-tell",
                "Its torque or its motion says nothing: no cause was looked for.",
            )
        else:
            ladder = " > ".join(f"{step} {error:.3g}" for step, _, error in steps)
            message = f"Error of its torque on unseen data, {unit}: {ladder}."
            if causes:
                share = rest / gap if gap > 0.0 else 0.0
                verdict = "explained" if share <= criteria.NEGLIGIBLE else "partly-explained"
                verdict = "mostly-explained" if criteria.NEGLIGIBLE < share <= criteria.MOST else verdict
                sentence = message
            else:
                verdict = "no-gap"
                sentence = (
                    f"No cause at this joint improves the prediction of data it has not seen. {message}"
                )
        raw, recalibrated, after = (float(error / noise) if np.isfinite(error) else 0.0 for error in errors)
        sizes = Sizes(raw, recalibrated, after, 1.0)
        shrinkage = Shrinkage(closed, closed, closed) if causes and steps else None
        attached = tuple(
            attached_effect
            for attached_effect in (self.attached(each.candidate) for each in own)
            if attached_effect is not None
        )
        name = f"{joint.output}_torque"
        return Diagnosis(
            name=f"{self.robot.name}: {joint.name}", model=f"{self.robot.name}-{joint.output}",
            source=str(self.dataset.source), verdict=verdict, sentence=sentence, gap=sizes, where=(), causes=causes,
            differs=(), candidates=tuple(self.rated(joint_index, own)) if steps else (), shrinkage=shrinkage,
            recalibration=self.recalibration(), corrected={}, effects=attached,
            limitations=("without repeats, noise and what no column explains are not told apart",),
            notes=tuple(cause.remark for cause in causes if cause.remark), what_next=(), channels=((name, unit),),
            input_channels=(), noise={name: noise}, trials=len(self.dataset.trials),
            conditions=len(dict.fromkeys(log.conditions)), repeats=1, missing=(),
            traces=tuple(self.traces(joint_index)) if steps else (), parameter_units={}, seed=self.seed,
            seconds=0.0, ladder=self.rungs(steps, name, noise),
            rest=Rest(sizes.after, rest / gap if gap > 0.0 and causes else 1.0),
        )  # fmt: skip

    @staticmethod
    def rungs(steps: Sequence["_Step"], output: str, noise: float) -> tuple[Rung, ...]:
        """Return the errors of a joint's torque on unseen data as the steps of a ladder."""
        if not steps:
            return ()
        gap, before, rungs = steps[1][2], steps[1][2], []
        for step, cause, error in steps:
            closes = (before - error) / gap if cause is not None and gap > 0.0 else 0.0
            rungs.append(Rung(step, cause, {output: error}, error / noise, closes))
            before = error if cause is not None else before
        return tuple(rungs)

    def recalibration(self) -> dict[str, tuple[float, float | str, float]]:
        """Return the masses of all links, in units of what is stated."""
        regressor = self.data.log.regressor
        off = self.data.deviation(self.answer.values, None)[:, 0]
        loads = self.data.deviation(self.answer.values, list(self.data.freed_directions))[:, 0]
        return {
            f"{identifier(body)}_mass_ratio": (
                1.0,
                criteria.MASS_TOLERANCE,
                float(1.0 + (off - loads)[row] / mass),
            )
            for row, (body, mass) in enumerate(zip(regressor.bodies, regressor.masses, strict=True))
        }

    def rated(self, joint_index: int, own: Sequence[Selected]) -> Iterator[RatedCandidate]:
        """Yield every candidate of a joint: a cause, as good as one, or how large it can be."""
        selection = self.answer.selection
        active = selection.active
        known = set(active.tolist())
        for selected in own:
            yield RatedCandidate(self.name(selected.candidate), "cause", None, self.sizes(selected.candidate))
        rivals = {rival.name: selected for selected in own for rival in selected.rivals}
        causes = {selected.candidate.name for selected in own}
        others = {
            candidate.name: candidate
            for candidate in reversed(selection.tried)
            if candidate.joint == joint_index
            and candidate.name not in causes
            and len(candidate.columns - known) == 1
            and not candidate.needs
        }
        rest = list(others.values())[::-1]
        groups = [np.array(sorted(candidate.columns - known)) for candidate in rest]
        before = selection.evidence.unseen(active)
        tables = selection.evidence.unseen_with(active, groups, [candidate.scope for candidate in rest])
        number = self.data.looked_at.index(joint_index)
        for candidate, group, (errors, values) in zip(rest, groups, tables, strict=True):
            with np.errstate(invalid="ignore"):
                share = 1.0 - float(np.nanmean(errors[:, number]) / np.nanmean(before[:, number]))
            best, spread = float(values.mean()), jackknife_error(values[:, 0])
            every = np.zeros(len(self.answer.values))
            every[:] = self.answer.values
            every[group] = abs(best) + numerics.NORMAL_95 * spread
            bounds = dict(self.parameters(candidate, every))
            units = self.parameter_units(candidate)
            bound = {
                name: ResampledNumber(abs(value), -abs(value), abs(value), units[name])
                for name, value in list(bounds.items())[:1]
            }
            if candidate.name in rivals:
                same = (self.name(rivals[candidate.name].candidate),)
                yield RatedCandidate(self.name(candidate), "rival", share, same_as=same)
            else:
                yield RatedCandidate(self.name(candidate), "excluded", share, upper_bound=bound)

    def traces(self, joint_index: int) -> Iterator[ComparedTrace]:
        """Yield logged and predicted torque of a few trials."""
        data, selection = self.data, self.answer.selection
        base = np.zeros(len(self.answer.values))
        base[selection.base] = selection.evidence.fit(selection.base)[selection.base]
        recalibrated, after = (
            data.predicted(base)[joint_index],
            data.predicted(self.answer.values)[joint_index],
        )
        rows = data.log.rows[joint_index]
        trials = list(zip(self.dataset.trials, rows, recalibrated, after, strict=True))
        trials.sort(
            key=lambda each: (
                -float(np.mean(np.square(each[1].torque - each[1].stated))) if len(each[1].torque) else 0.0
            )
        )
        for trial, row, before, last in trials[:_TRIALS_SHOWN]:
            if len(row.torque):
                yield ComparedTrace(
                    trial.label, trial.condition, 1, row.time_s, np.empty((len(row.time_s), 0)), row.torque[:, None],
                    row.stated[:, None], before[:, None], last[:, None],
                )  # fmt: skip


_ONLY: Mapping[str, str] = {
    "coulomb-friction": "torque",
    "viscous-damping": "coefficient",
    "added-inertia": "inertia",
    "load-dependent-friction": "coefficient",
    "asymmetric-damping": "difference",
    "added-stiffness": "stiffness",
}
"""Effects with one coefficient, and what it is called."""


def _effect(name: str) -> Effect:
    return load_effect(name, _SITE_KINDS.get(name, "joint"))  # type: ignore[arg-type]
