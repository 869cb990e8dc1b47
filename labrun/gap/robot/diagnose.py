"""A whole robot diagnosed: every joint by itself, then all that was found together in the whole robot."""

import hashlib
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import version
from typing import Protocol

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import effects
from labrun.fit import Dataset, Note, silent
from labrun.gap import criteria, numerics
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.diagnosis import Diagnosis
from labrun.gap.progress import Count
from labrun.gap.robot.clock import common_lead
from labrun.gap.robot.diagnosis import OF_THE_WHOLE, OfTheWhole, RobotDiagnosis
from labrun.gap.robot.links import links_that_explain
from labrun.gap.robot.one_joint import OneJoint, Prescribed, one_joint, prescribed
from labrun.gap.robot.tip_load import place_of_load
from labrun.gap.robot.together import together
from labrun.gap.robot.torque_diagnosis import diagnose_torques
from labrun.models import Model, Robot, identifier, simulate, suggest_substeps
from labrun.workers import Pool, pool, spread

OF_A_TORQUE = ("delay", "early-clock", "lag")
"""What a torque is not asked for at one joint: one that sticks brakes before it moves, which looks like a time."""
_CLOCKS = ("early-clock", "late-clock")
"""Of an encoder, and of its goals: beside the other, one is the other."""
_NOT_LOOKED_FOR = "no cause was looked for"


class KnownAnswers(Protocol):
    """Answers for joints that were diagnosed before, by a key that holds all that they depend on."""

    def get(self, key: str) -> Diagnosis | None:
        """Return an answer; None if there is none."""
        ...

    def keep(self, key: str, answer: Diagnosis) -> None:
        """Take an answer as soon as a joint is diagnosed."""
        ...


class _NothingKnown:
    def get(self, _key: str) -> Diagnosis | None:
        return None

    def keep(self, _key: str, _answer: Diagnosis) -> None:
        return


def diagnose_robot(
    robot: Robot,
    model: Model,
    dataset: Dataset,
    options: Options | None = None,
    *,
    note: Note = silent,
    known: KnownAnswers | None = None,
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
    known
        Joints that are done already, and where others go as soon as they are.

    Raises
    ------
    RequestError
        The robot cannot be taken apart into its joints; see `why_not`.
    RecordingError, FitError, ModelError
        Data or model that do not allow a diagnosis.
    """
    options, known = options or Options(), known or _NothingKnown()
    if robot.is_told_torques:
        return diagnose_torques(robot, model, dataset, options, note=note)
    start = time.perf_counter()
    note("finding what each joint carries along the measured motion")
    dynamics = prescribed(robot, model, dataset)
    note("asking all joints together for a clock of the log")
    led = dynamics.led(common_lead(dynamics, np.random.default_rng(options.seed)))
    dynamics = led if led.clock not in options.withhold else dynamics
    alone, deadline_s = replace(options, places=False, brisk=True), start + options.within_s
    every = range(len(robot.joints))
    # a process a joint: half of a diagnosis is Python, which threads would wait for in turn
    with nullcontext() if options.workers <= 1 else pool(min(options.workers, len(every)), None) as there:
        note("recalibrating every joint")
        answers = _looked(dynamics, every, replace(alone, least_gap=np.inf), there, note, deadline_s, known)
        lacking = [index for index, (_, answer) in enumerate(answers) if not _quiet(answer)]
        note("asking all joints together which links are not where their encoders say")
        links = links_that_explain(dynamics, lacking, options.seed)
        for at in ([index for index in lacking if index not in links], *([link] for link in links)):
            around = dynamics.with_links({other: by for other, by in links.items() if other not in at})
            second = dict(zip(at, _looked(around, at, alone, there, note, deadline_s, known), strict=True))
            answers = [second.get(number, answer) for number, answer in enumerate(answers)]
        dynamics = dynamics.with_links(links)
        tip, far_end = dynamics.tip, dynamics.tip.far_end
        hanging = [index for index in _where_something_hangs(answers, tip.body) if index not in links]
        better = place_of_load(dynamics, tip) if hanging else None
        if better is not None:
            note(
                "looking again at joints that carry more, for a load where all joints together tell it to be"
            )
            moved = dynamics.with_load_at(tip.torque(better))
            second = dict(
                zip(hanging, _looked(moved, hanging, alone, there, note, deadline_s, known), strict=True)
            )
            if _explained_by_load(answers, hanging) < _explained_by_load(second, hanging):
                answers = [second.get(number, answer) for number, answer in enumerate(answers)]
                dynamics, far_end = moved, better
        whole = _of_the_whole(answers, far_end)
        again = _that_others_may_explain(answers, links) if whole else []
        if again:
            note("looking again at joints that say something else, with base and load as others tell them")
            second = dict(
                zip(
                    again,
                    _looked(among(dynamics, whole), again, alone, there, note, deadline_s, known),
                    strict=True,
                )
            )
            answers = _explained_by_others(answers, second)
    if dynamics.lead_s:
        driven = [joint.joint.name for joint, _ in answers if dynamics.drive(joint.joint) is not None]
        (parameter,) = dynamics.clock_at(dynamics.robot.actuators[0].input).named_values
        whole = (*whole, (dynamics.clock, tuple(driven), {parameter: abs(dynamics.lead_s)}))
    note("simulating the whole robot with what was found")
    return together(dynamics, answers, whole, start)


def _looked(
    dynamics: Prescribed,
    joint_indices: Sequence[int],
    options: Options,
    there: Pool | None,
    note: Note,
    deadline_s: float,
    known: KnownAnswers,
) -> list[tuple[OneJoint, Diagnosis]]:
    """Diagnose joints, on processes if there are some; the answers are the same and come in the joints' order."""
    if not joint_indices:
        return []
    joints = {index: one_joint(dynamics, index) for index in joint_indices}
    # the time that is left is shared by the joints that wait for one another
    left_s = max(deadline_s - time.perf_counter(), 0.0) * max(options.workers, 1) / len(joints)
    drawn = dynamics.redrawn(np.random.default_rng(options.seed))
    least = {index: _least_gap(joint, one_joint(drawn, index)) for index, joint in joints.items()}
    asked = {
        index: replace(
            options,
            within_s=left_s,
            workers=1,
            least_gap=max(options.least_gap, gap),
            withhold=(*options.withhold, *(OF_A_TORQUE if joints[index].by_torque else ())),
        )
        for index, gap in least.items()
    }
    keys = {index: _key(joint, asked[index]) for index, joint in joints.items()}
    stored = {index: known.get(key) for index, key in keys.items()}
    answers = {index: answer for index, answer in stored.items() if answer is not None}
    count = Count(len(joints) - len(answers))

    def report(text: str) -> None:
        left = f", {count.time_left}" if count.time_left else ""
        note(f"{len(answers)} of {len(joints)} joints done{left}{text}")

    open_joints = {index: joint for index, joint in joints.items() if index not in answers}

    def here() -> Iterator[tuple[int, Diagnosis]]:
        for index, joint in open_joints.items():
            announce = _about(joint, report)
            yield index, diagnose_dataset(joint.dataset, joint.model, asked[index], note=announce)

    jobs = (
        (index, diagnose_dataset, (joint.dataset, joint.model, asked[index]))
        for index, joint in open_joints.items()
    )
    report("")
    for index, raw_answer in here() if there is None else spread(there, jobs):
        answer = _announced(raw_answer, least[index], dynamics.own.step_s)
        answers[index] = answer
        if answer.complete:
            known.keep(keys[index], answer)
        count.done += 1
        causes = " and ".join(cause.name.words for cause in answer.causes)
        report(f"; {joints[index].joint.name}: {causes or answer.verdict}")
    return [(joint, answers[index]) for index, joint in joints.items()]


def _key(joint: OneJoint, options: Options) -> str:
    """Return a digest of all that a joint's complete answer depends on."""
    digest = hashlib.sha256()
    chosen = replace(options, within_s=np.inf, workers=1)
    library = sorted((effect.id, effect.kind) for effect in effects())
    data = joint.dataset
    digest.update(
        f"{version('labrun')} {library} {chosen} {joint.text} {data.inputs} {data.outputs}".encode()
    )
    for trial in data.trials:
        digest.update(f"{trial.label} {trial.condition} {trial.repeat}".encode())
        for values in (trial.time_s, trial.inputs, trial.outputs):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _about(joint: OneJoint, note: Note) -> Note:
    return lambda text: note(f"; {joint.joint.name}: {text}")


def _least_gap(joint: OneJoint, drawn: OneJoint) -> float:
    """Return the gap of a joint, in units of its noise, below which no cause is looked for."""
    return max(criteria.LEAST_JOINT_GAP, _smoothing_gap(joint, drawn))


def _smoothing_gap(joint: OneJoint, drawn: OneJoint) -> float:
    """Return what smoothing noise out of the others' motion leaves at a joint, in units of the joint's own noise.

    A light joint at the end of a long arm feels every acceleration of the others, and so what is wrong with it.

    Parameters
    ----------
    drawn
        The same with the noise of all joints drawn again, see `Prescribed.redrawn`.
    """
    names = [signal.name for signal in joint.model.inputs]
    if joint.by_torque:
        return 0.0  # its own motion is smoothed as well, and what that leaves is in the noise of its torque
    if names != [signal.name for signal in drawn.model.inputs]:
        return 0.0  # a body was near enough to the share that counts to be taken in once: a small one
    own = [names.index("measured"), names.index("measured_rate")]
    apart, left, substeps = [], [], None
    for trial, other in zip(joint.dataset.trials, drawn.dataset.trials, strict=True):
        begin, inputs = trial.inputs[0, own], other.inputs.copy()
        inputs[:, own] = trial.inputs[:, own]
        substeps = substeps or suggest_substeps(
            joint.model, trial.time_s[:50], trial.inputs[:50], initial_state=begin, condition=trial.condition,
            tolerance=1e-3, most=numerics.ROBOT_SUBSTEPS,
        )  # fmt: skip
        courses = [
            simulate(
                joint.model,
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
    spread = float(np.std(np.concatenate([trial.outputs[:, 0] for trial in joint.dataset.trials])))
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
        if not answer.causes and answer.verdict != "unexplained":
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
    return replace(
        answer, verdict="no-gap", causes=(), effects=(), shrinkage=None, what_next=(), sentence=sentence,
        corrected={name: value for name, (_, _, value) in answer.recalibration.items()},
        gap=replace(answer.gap, after=answer.gap.recalibrated), ladder=answer.ladder[:2],
        notes=(*answer.notes, below),
    )  # fmt: skip


def _quiet(answer: Diagnosis) -> bool:
    """Tell whether recalibration leaves no more of a joint than prescribed motion makes by itself."""
    return any(note.startswith(_NOT_LOOKED_FOR) for note in answer.notes)


def among(dynamics: Prescribed, whole: Sequence[OfTheWhole]) -> Prescribed:
    """Return the joints of a robot whose base, load and gravity compensation are known."""
    values_of = {name: values for name, _, values in whole}
    tilt, load = values_of.get("gravity-tilt", {}), values_of.get("payload", {})
    dynamics = dynamics.on_base(tilt.get("roll", 0.0), tilt.get("pitch", 0.0))
    dynamics = dynamics.held(values_of.get("gravity-compensation", {}).get("share", 0.0))
    if not load:
        return dynamics
    at = np.array([load[axis] for axis in "xyz"])  # where links were moved, it is not there yet
    return dynamics.with_load_at(dynamics.tip.torque(at)).loaded(load["mass"])


def _where_something_hangs(answers: Sequence[tuple[OneJoint, Diagnosis]], body: str) -> list[int]:
    """Return the joints that tell a load, or that the last body is heavier than stated: alone they look the same."""
    heavier = f"{identifier(body)}_mass_ratio"
    return [
        index
        for index, (_, answer) in enumerate(answers)
        if {cause.name.effect for cause in answer.causes} & {"payload", heavier}
    ]


def _explained_by_load(
    answers: Sequence[tuple[OneJoint, Diagnosis]] | Mapping[int, tuple[OneJoint, Diagnosis]],
    at: Sequence[int],
) -> tuple[int, float]:
    """Return at how many of some joints a load, and nothing else, explains what they lack; and minus what it leaves."""
    asked = [answers[index][1] for index in at]
    loaded = sum([cause.name.effect for cause in answer.causes] == ["payload"] for answer in asked)
    return loaded, -sum(answer.gap.after**2 for answer in asked)


def _that_others_may_explain(
    answers: Sequence[tuple[OneJoint, Diagnosis]], links: Collection[int]
) -> list[int]:
    """Return the joints that lack something, none of the robot as a whole and no link of their own."""
    return [
        index
        for index, (_, answer) in enumerate(answers)
        if (answer.causes or answer.verdict == "unexplained")
        and index not in links
        and not {cause.name.effect for cause in answer.causes} & set(OF_THE_WHOLE)
    ]


def _explained_by_others(
    answers: Sequence[tuple[OneJoint, Diagnosis]], again: Mapping[int, tuple[OneJoint, Diagnosis]]
) -> list[tuple[OneJoint, Diagnosis]]:
    """Return the answers, of joints at which what others tell leaves less than half of the gap the new ones.

    A tilt asks the same torque of a joint about the vertical wherever it stands: alone it looks like a constant force.
    """
    return [
        again[index]
        if index in again and again[index][1].gap.recalibrated < criteria.MOST * answer[1].gap.recalibrated
        else answer
        for index, answer in enumerate(answers)
    ]


def _of_the_whole(
    answers: Sequence[tuple[OneJoint, Diagnosis]], load_at: FloatArray
) -> tuple[OfTheWhole, ...]:
    wholes: list[OfTheWhole] = []
    for effect in OF_THE_WHOLE:
        shown = [
            (joint.joint.name, cause)
            for joint, answer in answers
            for cause in answer.causes
            if cause.name.effect == effect
        ]
        if shown:
            values = {
                name: float(np.median([cause.values[name].value for _, cause in shown]))
                for name in shown[0][1].values
            }
            values |= dict(zip("xyz", load_at.tolist(), strict=True)) if effect == "payload" else {}
            wholes.append((effect, tuple(name for name, _ in shown), values))
    return tuple(wholes)
