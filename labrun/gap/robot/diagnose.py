"""A whole robot diagnosed: every joint by itself, then all that was found together in the whole robot."""

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.fit import Dataset, Note, silent
from labrun.gap import criteria
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.diagnosis import Diagnosis, Verdict
from labrun.gap.robot.clock import common_lead
from labrun.gap.robot.links import links_that_explain
from labrun.gap.robot.one_joint import OneJoint, Prescribed, one_joint, prescribed
from labrun.gap.robot.tip_load import place_of_load
from labrun.models import Model, Robot, RobotJoint, identifier, simulate, suggest_substeps
from labrun.workers import Pool, pool, spread

OfTheWhole = tuple[str, tuple[str, ...], Mapping[str, float]]
"""An effect of the whole robot, the joints that tell it, and its values."""
OF_THE_WHOLE = ("gravity-tilt", "payload")
"""Effects that one joint shows and the whole robot has."""
IN_THE_ROBOT: Mapping[str, Mapping[str, str]] = {
    "gravity-tilt": {"base_roll": "roll", "base_pitch": "pitch"},
    "payload": {"tip_load": "mass", "tip_load_x": "x", "tip_load_y": "y", "tip_load_z": "z"},
}
"""Their parameters in the model of the whole robot, and what these are called in the effect."""
OF_THE_LOG = ("late-clock", "delay")
"""Of all goals at once: stamped late beside all angles, or followed late by them."""
OF_A_TORQUE = ("delay", "early-clock", "lag")
"""What a torque is not asked for at one joint: one that sticks brakes before it moves, which looks like a time."""
_CLOCKS = ("early-clock", "late-clock")
"""Of an encoder, and of its goals: beside the other, one is the other."""
_NOT_LOOKED_FOR = "no cause was looked for"
_MOST_SUBSTEPS = 16


@dataclass(frozen=True)
class JointDiagnosis:
    """What was found about one joint.

    Attributes
    ----------
    stated, recalibrated, corrected
        Root mean square of measured minus simulated of this joint, in its unit, where the whole robot is simulated:
        with the model as stated, with parameters recalibrated, with all causes of all joints added. NaN where the
        simulation leaves the finite numbers.
    agreed
        Its parameters as the median of what all joints say: a mass moves every joint that carries it.
    """

    joint: RobotJoint
    diagnosis: Diagnosis
    stated: float
    recalibrated: float
    corrected: float
    agreed: Mapping[str, float] = field(default_factory=dict)

    @property
    def moved(self) -> dict[str, float]:
        """Parameters that explain the joint by being far from what is stated, by the factor they are off; else none.

        None of a joint that moves as stated to within one trial's noise: gain, damping and mass trade for one another.
        """
        if self.diagnosis.causes or self.diagnosis.verdict != "parameter" or self.diagnosis.gap.raw <= 1.0:
            return {}
        return {
            name.removesuffix("_ratio"): found / stated
            for name, (stated, tolerance, found) in self.diagnosis.recalibration.items()
            if isinstance(tolerance, float)
            and stated
            and 0
            < criteria.FAR_MOVED * tolerance
            <= min(abs(one / stated - 1.0) for one in (found, self.agreed.get(name, found)))
        }


@dataclass(frozen=True)
class RobotDiagnosis:
    """What was found about a robot.

    Attributes
    ----------
    whole
        Causes of the robot as a whole (a tilted base, a load, a clock of all goals), with the joints that show each.
    effects, values
        All causes as they go into the model of the whole robot, and its parameters.
    remarks
        What to know, in sentences.
    """

    name: str
    model: str
    source: str
    joints: tuple[JointDiagnosis, ...]
    whole: tuple[OfTheWhole, ...]
    effects: tuple[AttachedEffect, ...]
    values: Mapping[str, float]
    remarks: tuple[str, ...]
    seconds: float

    @property
    def named(self) -> tuple[JointDiagnosis, ...]:
        """The joints at which a cause was found."""
        return tuple(one for one in self.joints if one.diagnosis.causes)

    @property
    def clock(self) -> str:
        """What the goals of all joints have in time beside the angles; "" if nothing."""
        return next((name for name, _, _ in self.whole if name in OF_THE_LOG), "")

    @property
    def sentence(self) -> str:
        """The answer, as a sentence."""
        found = [
            f"{one.joint.name}: {' and '.join(cause.name.words.partition(' at ')[0] for cause in one.diagnosis.causes)}"
            for one in self.named
        ]
        unexplained = [one.joint.name for one in self.joints if one.diagnosis.verdict == "not-in-library"]
        found += [_clock_words(name, values) for name, _, values in self.whole if name in OF_THE_LOG]
        told = "; ".join(found) if found else "nothing but recalibration is asked for at any joint"
        far = [f"{name} {100 * (by - 1):+.2g} %" for one in self.joints for name, by in one.moved.items()]
        if far and not found:
            told = f"parameters are far from what is stated: {', '.join(far)}"
        several = self.named and len(self.joints) > 1
        count = f"{len(self.named)} of {len(self.joints)} joints lack physics: " if several else ""
        rest = f"; not in the library: {', '.join(unexplained)}" if unexplained else ""
        rest += f"; far from what is stated: {', '.join(far)}" if far and found else ""
        return f"{count}{told}{rest}."

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints, with what makes the corrected model."""
        found = bool(self.named or self.whole)
        return {
            "verdict": "explained" if found else "no-gap",
            "sentence": self.sentence,
            "name": self.name,
            "model": self.model,
            "source": self.source,
            "joints": [
                {
                    "joint": one.joint.name, "unit": one.joint.unit, "stated": _number(one.stated),
                    "recalibrated": _number(one.recalibrated), "corrected": _number(one.corrected),
                    "moved": one.moved, "diagnosis": one.diagnosis.to_json(),
                }
                for one in self.joints
            ],
            "whole": [
                {"effect": name, "joints": list(joints), "values": dict(values)}
                for name, joints, values in self.whole
            ],
            "corrected": dict(self.values),
            "effects": [
                {"effect": one.effect.id, "kind": one.effect.kind, "site": one.site, "values": list(one.values)}
                for one in self.effects
            ],
            "notes": list(self.remarks),
            "data": {
                "trials": self.joints[0].diagnosis.trials,
                "conditions": self.joints[0].diagnosis.conditions,
                "repeats": self.joints[0].diagnosis.repeats,
            },
            "seed": self.joints[0].diagnosis.seed,
            "limitations": [],
            "causes": [cause for one in self.joints for cause in one.diagnosis.to_json()["causes"]],
            "seconds": round(self.seconds, 2),
        }  # fmt: skip


def diagnose_robot(
    robot: Robot, model: Model, dataset: Dataset, options: Options | None = None, *, note: Note = silent
) -> RobotDiagnosis:
    """Say of every joint where model and log differ, which cause explains it, and how far.

    Each joint is diagnosed as a model of its own in which the other joints move as they were measured; what is found
    is then put into the model of the whole robot, which is simulated beside the log.

    Parameters
    ----------
    robot
        The robot's file.
    model
        The model of the whole robot, as `labrun.models.load_model` makes it from that file.
    options
        ``workers`` joints are looked at at once, each in a process of its own.

    Raises
    ------
    RequestError
        The robot cannot be taken apart into its joints; see `why_not`.
    RecordingError, FitError, ModelError
        Data or model that do not allow a diagnosis.
    """
    options = options or Options()
    start = time.perf_counter()
    note("finding what each joint carries along the measured motion")
    found = prescribed(robot, model, dataset)
    note("asking all joints together for a clock of the log")
    led = found.led(common_lead(found, np.random.default_rng(options.seed)))
    found = led if led.clock not in options.withhold else found
    alone = replace(options, workers=1, places=False, brisk=True)
    every = range(len(robot.joints))
    # a process a joint: half of a diagnosis is Python, which threads would wait for in turn
    with nullcontext() if options.workers <= 1 else pool(min(options.workers, len(every)), None) as there:
        note("recalibrating every joint")
        answers = _looked(found, every, replace(alone, least_gap=np.inf), there, note)
        lacking = [place for place, (_, answer) in enumerate(answers) if not _quiet(answer)]
        note("asking all joints together which links are not where their encoders say")
        links = links_that_explain(found, lacking, options.seed)
        for at in ([one for one in lacking if one not in links], *([one] for one in links)):
            around = found.with_links({other: by for other, by in links.items() if other not in at})
            second = dict(zip(at, _looked(around, at, alone, there, note), strict=True))
            answers = [second.get(number, one) for number, one in enumerate(answers)]
        found = found.with_links(links)
        tip, place = found.tip, found.tip.far_end
        hanging = [one for one in _where_something_hangs(answers, tip.body) if one not in links]
        better = place_of_load(found, tip) if hanging else None
        if better is not None:
            note(
                "looking again at joints that carry more, for a load where all joints together tell it to be"
            )
            moved = found.with_load_at(tip.torque(better))
            second = dict(zip(hanging, _looked(moved, hanging, alone, there, note), strict=True))
            if _explained_by_load(answers, hanging) < _explained_by_load(second, hanging):
                answers = [second.get(number, one) for number, one in enumerate(answers)]
                found, place = moved, better
        whole = _of_the_whole(answers, place)
        again = _that_others_may_explain(answers, links) if whole else []
        if again:
            note("looking again at joints that say something else, with base and load as others tell them")
            second = dict(zip(again, _looked(among(found, whole), again, alone, there, note), strict=True))
            answers = _explained_by_others(answers, second)
    if found.lead_s:
        driven = [one.joint.name for one, _ in answers if found.drive(one.joint) is not None]
        (parameter,) = found.clock_at(found.robot.actuators[0].input).named_values
        whole = (*whole, (found.clock, tuple(driven), {parameter: abs(found.lead_s)}))
    note("simulating the whole robot with what was found")
    return _together(found, answers, whole, start)


def _looked(
    found: Prescribed, places: Sequence[int], options: Options, there: Pool | None, note: Note
) -> list[tuple[OneJoint, Diagnosis]]:
    """Diagnose joints, on processes if there are some; the answers are the same and come in the joints' order."""
    if not places:
        return []
    joints = {place: one_joint(found, place) for place in places}
    drawn = found.redrawn(np.random.default_rng(options.seed))
    least = {place: _least_gap(one, one_joint(drawn, place)) for place, one in joints.items()}
    asked = {
        place: replace(
            options,
            least_gap=max(options.least_gap, one),
            withhold=(*options.withhold, *(OF_A_TORQUE if joints[place].by_torque else ())),
        )
        for place, one in least.items()
    }
    answers: dict[int, Diagnosis] = {}

    def told(text: str) -> None:
        note(f"{len(answers)} of {len(joints)} joints{text}")

    def here() -> Iterator[tuple[int, Diagnosis]]:
        for place, one in joints.items():
            yield place, diagnose_dataset(one.dataset, one.model, asked[place], note=_about(one, told))

    jobs = (
        (place, diagnose_dataset, (one.dataset, one.model, asked[place])) for place, one in joints.items()
    )
    told("")
    for place, answer in here() if there is None else spread(there, jobs):
        answers[place] = _announced(answer, least[place], found.own.step_s)
        told(f": {joints[place].joint.name} {answers[place].verdict}")
    return [(one, answers[place]) for place, one in joints.items()]


def _about(one: OneJoint, told: Note) -> Note:
    return lambda text: told(f" done; {one.joint.name}: {text}")


def _least_gap(one: OneJoint, drawn: OneJoint) -> float:
    """Return the gap of a joint, in units of its noise, below which no cause is looked for."""
    return max(criteria.LEAST_JOINT_GAP, criteria.LINEAR_SLACK * _smoothing_gap(one, drawn))


def _smoothing_gap(one: OneJoint, drawn: OneJoint) -> float:
    """Return what smoothing noise out of the others' motion leaves at a joint, in units of the joint's own noise.

    A light joint at the end of a long arm feels every acceleration of the others, and so what is wrong with it.

    Parameters
    ----------
    drawn
        The same with the noise of all joints drawn again, see `Prescribed.redrawn`.
    """
    names = [signal.name for signal in one.model.inputs]
    if one.by_torque or names != [signal.name for signal in drawn.model.inputs]:
        return 0.0  # a body was near enough to the share that counts to be taken in once: a small one
    own = [names.index("measured"), names.index("measured_rate")]
    apart, left, substeps = [], [], None
    for trial, other in zip(one.dataset.trials, drawn.dataset.trials, strict=True):
        begin, inputs = trial.inputs[0, own], other.inputs.copy()
        inputs[:, own] = trial.inputs[:, own]
        substeps = substeps or suggest_substeps(
            one.model, trial.time_s[:50], trial.inputs[:50], initial_state=begin, condition=trial.condition,
            tolerance=1e-3, most=_MOST_SUBSTEPS,
        )  # fmt: skip
        courses = [
            simulate(
                one.model,
                trial.time_s,
                each,
                condition=trial.condition,
                initial_state=begin,
                substeps=substeps,
            ).outputs[:, 0]
            for each in (trial.inputs, inputs)
        ]
        apart.append(courses[1] - courses[0])
        left.append(trial.outputs[:, 0] - trial.inputs[:, own[0]])
    # a gap is told in units of what is believed of a model: where an encoder is finer than that, not in the encoder's
    spread = float(np.std(np.concatenate([trial.outputs[:, 0] for trial in one.dataset.trials])))
    noise = max(float(np.sqrt(np.mean(np.square(np.concatenate(left))))), criteria.MODEL_ROUNDING * spread)
    ratio = np.sqrt(np.mean(np.square(np.concatenate(apart)))) / noise
    return float(ratio) if np.isfinite(ratio) else 0.0


def _announced(answer: Diagnosis, least: float, step_s: float) -> Diagnosis:
    """Return a diagnosis without causes where the gap is one that prescribed motion or a simulator makes by itself.

    Parameters
    ----------
    least
        Below which no cause was looked for, see `_least_gap`.
    step_s
        The file's own time step. A log that a simulator wrote leads the equations of motion by up to that much: its
        integrator moves on with the rates at the end of each step, not with those on the way.
    """
    if answer.gap.recalibrated < least:
        sentence = (
            "Recalibrated, the joint moves as measured, but for less than smoothing of the others may leave."
        )
        below = f"{_NOT_LOOKED_FOR}: {answer.gap.recalibrated:.2g} of the noise is less than {least:.2g}"
        if not answer.causes and answer.verdict != "not-in-library":
            return replace(answer, notes=(*answer.notes, below))
    elif answer.causes and all(
        cause.name.effect in _CLOCKS and cause.values["lead"].value < step_s for cause in answer.causes
    ):
        sentence = "Recalibrated, the joint moves as measured, but for less than a time step of the file."
        names = " and ".join(str(cause.name) for cause in answer.causes)
        below = (
            f"{names} would explain what is left, but leads by less than the {1e3 * step_s:.3g} ms a simulator takes "
            "in one step: not announced"
        )
    else:
        return answer
    # of a parameter alone, how far it is off is told with the joint: see `JointDiagnosis.moved`
    verdict: Verdict = "parameter" if answer.verdict == "parameter" else "no-gap"
    return replace(
        answer, verdict=verdict, causes=(), effects=(), shrinkage=None, what_next=(), sentence=sentence,
        corrected={name: value for name, (_, _, value) in answer.recalibration.items()},
        gap=replace(answer.gap, after=answer.gap.recalibrated),
        notes=(*answer.notes, below),
    )  # fmt: skip


def _quiet(answer: Diagnosis) -> bool:
    """Tell whether recalibration leaves no more of a joint than prescribed motion makes by itself."""
    return any(note.startswith(_NOT_LOOKED_FOR) for note in answer.notes)


def among(found: Prescribed, whole: Sequence[OfTheWhole]) -> Prescribed:
    """Return the joints of a robot whose base and load are known."""
    told = {name: values for name, _, values in whole}
    tilt, load = told.get("gravity-tilt", {}), told.get("payload", {})
    found = found.on_base(tilt.get("roll", 0.0), tilt.get("pitch", 0.0))
    if not load:
        return found
    at = np.array([load[axis] for axis in "xyz"])  # where links were moved, it is not there yet
    return found.with_load_at(found.tip.torque(at)).loaded(load["mass"])


def _where_something_hangs(answers: Sequence[tuple[OneJoint, Diagnosis]], body: str) -> list[int]:
    """Return the joints that tell a load, or that the last body is heavier than stated: alone they look the same."""
    heavier = f"{identifier(body)}_mass_ratio"
    return [
        place
        for place, (_, answer) in enumerate(answers)
        if {cause.name.effect for cause in answer.causes} & {"payload", heavier}
    ]


def _explained_by_load(
    answers: Sequence[tuple[OneJoint, Diagnosis]] | Mapping[int, tuple[OneJoint, Diagnosis]],
    at: Sequence[int],
) -> tuple[int, float]:
    """Return at how many of some joints a load, and nothing else, explains what they lack; and minus what it leaves."""
    told = [answers[place][1] for place in at]
    loaded = sum([cause.name.effect for cause in answer.causes] == ["payload"] for answer in told)
    return loaded, -sum(answer.gap.after**2 for answer in told)


def _that_others_may_explain(
    answers: Sequence[tuple[OneJoint, Diagnosis]], links: Collection[int]
) -> list[int]:
    """Return the joints that lack something, none of the robot as a whole and no link of their own."""
    return [
        place
        for place, (_, answer) in enumerate(answers)
        if (answer.causes or answer.verdict == "not-in-library")
        and place not in links
        and not {cause.name.effect for cause in answer.causes} & set(OF_THE_WHOLE)
    ]


def _explained_by_others(
    answers: Sequence[tuple[OneJoint, Diagnosis]], again: Mapping[int, tuple[OneJoint, Diagnosis]]
) -> list[tuple[OneJoint, Diagnosis]]:
    """Return the answers, of joints at which what others tell leaves less than half of the gap the new ones.

    A tilt asks the same torque of a joint about the vertical wherever it stands: alone it looks like a constant force.
    """
    return [
        again[place]
        if place in again
        and again[place][1].gap.recalibrated < criteria.EXPLAINED_BY_OTHERS * one[1].gap.recalibrated
        else one
        for place, one in enumerate(answers)
    ]


def _together(
    found: Prescribed,
    answers: Sequence[tuple[OneJoint, Diagnosis]],
    whole: Sequence[OfTheWhole],
    start: float,
) -> RobotDiagnosis:
    model = found.whole
    names = {one.name for one in model.parameters}
    recalibrated, corrected = _values(model, answers, after=False), _values(model, answers, after=True)
    effects, left = [], []
    for _, answer in answers:
        for one in answer.effects:
            try:
                one.check(model)
                effects.append(one)
            except Exception as error:
                if one.effect.id not in OF_THE_WHOLE:
                    left.append(f"{one.effect.id} at {one.site} is not in the corrected model: {error}")
    effects += [found.clock_at(one.input) for one in found.robot.actuators if found.lead_s]
    before, after, last = (
        _errors(found, model.with_values(values).with_effects(added))
        for values, added in (({}, ()), (recalibrated, ()), (corrected, tuple(effects)))
    )
    for name, told_by, values in whole:
        if name in OF_THE_LOG:
            continue
        put = {parameter: values[one] for parameter, one in IN_THE_ROBOT[name].items() if parameter in names}
        with_it = _errors(found, model.with_values(corrected | put).with_effects(effects))
        if len(put) == len(values) and np.sum(np.square(with_it / after)) < np.sum(np.square(last / after)):
            corrected, last = corrected | put, with_it
        else:
            left.append(
                f"{name} is told by {', '.join(told_by)} and is not in the corrected model: with it the whole robot "
                "is simulated no better"
            )
    fall = [one.joint.name for one, _ in answers if one.by_torque]
    if fall:
        left.append(
            f"{', '.join(fall)}: driven by the torque that was logged; nothing holds the whole robot there, so that "
            "its simulation drifts from the log, and how far says little"
        )
    told: dict[str, list[float]] = {}
    for _, answer in answers:
        for name, (_, _, value) in answer.recalibration.items():
            told.setdefault(name, []).append(value)
    agreed = {name: float(np.median(values)) for name, values in told.items()}
    joints = tuple(
        JointDiagnosis(
            one.joint, answer, float(before[place]), float(after[place]), float(last[place]), agreed
        )
        for place, (one, answer) in enumerate(answers)
    )
    return RobotDiagnosis(
        found.robot.name, model.name, str(found.dataset.source), joints, tuple(whole), tuple(effects),
        {name: value for name, value in corrected.items() if name in names}, tuple(left), time.perf_counter() - start,
    )  # fmt: skip


def _values(model: Model, answers: Sequence[tuple[OneJoint, Diagnosis]], *, after: bool) -> dict[str, float]:
    """Return the parameters of the whole robot: a joint's own from that joint, a mass as the mean over joints."""
    stated = {one.name: one.value for one in model.parameters}
    told: dict[str, list[float]] = {}
    for one, answer in answers:
        every = {name: value for name, (_, _, value) in answer.recalibration.items()}
        every |= answer.corrected if after else {}
        _into_damping(one.joint.output, every, answer)
        for name, value in every.items():
            if name in stated:
                told[name] = [value]
            elif (mass := name.removesuffix("_ratio")) in stated:
                told.setdefault(mass, []).append(value * stated[mass])
    return {name: float(np.mean(values)) for name, values in told.items()}


def _into_damping(joint: str, values: dict[str, float], answer: Diagnosis) -> None:
    """Give the joint's damping what its servo's rate gain changed by: the whole robot has the sum in one place."""
    damping = f"{joint}_damping"
    for name in [name for name in values if name.endswith("_kv")]:
        values[damping] = max(values[damping] + values.pop(name) - answer.recalibration[name][0], 0.0)


def _of_the_whole(
    answers: Sequence[tuple[OneJoint, Diagnosis]], load_at: FloatArray
) -> tuple[OfTheWhole, ...]:
    found: list[OfTheWhole] = []
    for effect in OF_THE_WHOLE:
        shown = [
            (one.joint.name, cause)
            for one, answer in answers
            for cause in answer.causes
            if cause.name.effect == effect
        ]
        if shown:
            values = {
                name: float(np.median([cause.values[name].value for _, cause in shown]))
                for name in shown[0][1].values
            }
            values |= dict(zip("xyz", load_at.tolist(), strict=True)) if effect == "payload" else {}
            found.append((effect, tuple(name for name, _ in shown), values))
    return tuple(found)


def _errors(found: Prescribed, model: Model) -> FloatArray:
    """Return the root mean square of measured minus simulated of every joint, whole trials simulated at once."""
    data = found.dataset
    names = [one.name for one in data.outputs]
    columns = [names.index(one.output) for one in found.robot.joints]
    model = model.with_between({one.name: one.between for one in data.inputs})
    squares, count, substeps = np.zeros(len(columns)), 0, None
    for trial, (q, rate, _) in zip(data.trials, found.motions, strict=True):
        known = {joint.output: float(q[0, k]) for k, joint in enumerate(found.robot.joints)}
        known |= {f"{joint.output}_rate": float(rate[0, k]) for k, joint in enumerate(found.robot.joints)}
        begin = np.array([known.get(state, 0.0) for state in model.states])
        if substeps is None:
            substeps = suggest_substeps(
                model,
                trial.time_s[:50],
                trial.inputs[:50],
                initial_state=begin,
                tolerance=1e-3,
                most=_MOST_SUBSTEPS,
            )
        made = simulate(
            model,
            trial.time_s,
            trial.inputs,
            initial_state=begin,
            condition=trial.condition,
            substeps=substeps,
        )
        squares += np.sum((trial.outputs[:, columns] - made.outputs[:, columns]) ** 2, axis=0)
        count += len(trial.time_s)
    return np.sqrt(squares / max(count, 1))


def _clock_words(effect: str, values: Mapping[str, float]) -> str:
    (time_s,) = values.values()
    if effect == "delay":
        return f"all joints: goals are followed {1e3 * time_s:.3g} ms late"
    return f"the log: goals are stamped {1e3 * time_s:.3g} ms late beside all angles"


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
