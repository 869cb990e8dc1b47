"""What differs between the logs of a robot: joints whose causes have other sizes in each log."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Note, Problem, minimise, silent
from labrun.gap import decide, numerics
from labrun.gap.averaging import averaged
from labrun.gap.diagnosis import effect_words
from labrun.gap.held_out import unseen_residuals
from labrun.gap.robot.as_diagnosed import DiagnosedJoint, diagnosed_joints
from labrun.gap.robot.one_joint import prescribed
from labrun.gap.robot.withheld_fits import problem_of
from labrun.models import Model, Robot

LOG = "log"
"""Condition that names the log of a trial, where there are several."""


def differences_between_logs(
    robot: Robot, model: Model, dataset: Dataset, diagnosis: Mapping[str, Any], *, note: Note = silent
) -> tuple[str, ...]:
    """Return a sentence for every joint whose sizes differ by log, by the rule; none where there is one log.

    A joint differs if fits to each log by itself predict trials that they have not seen better than fits to all logs.

    Parameters
    ----------
    robot, model, dataset
        As they were diagnosed.
    diagnosis
        As `RobotDiagnosis.to_json` gives it.
    """
    logs = list(
        dict.fromkeys(str(trial.condition[LOG]) for trial in dataset.trials if LOG in trial.condition)
    )
    if len(logs) < 2 or robot.is_told_torques:
        return ()
    sentences = []
    for joint in diagnosed_joints(prescribed(robot, model, dataset), diagnosis):
        note(f"asking whether the logs differ: {joint.isolated.joint.name}")
        sentences += _difference(joint, logs)
    return tuple(sentences)


def _difference(joint: DiagnosedJoint, logs: Sequence[str]) -> list[str]:
    data = averaged(joint.isolated.dataset, joint.isolated.model)
    released = [cause["effect"] for cause in joint.answer["causes"] if cause["kind"] == "parameter"]
    isolated = replace(joint.isolated, dataset=data)
    problem, start = problem_of(isolated, joint.effects, released, joint.answer["corrected"])
    if problem is None or not joint.effects:
        return []
    members = {
        log: [index for index, trial in enumerate(problem.data.trials) if trial.condition[LOG] == log]
        for log in logs
    }
    if any(len(indices) < 2 for indices in members.values()):
        return []
    common = [_mean_square(residual) for residual, _ in unseen_residuals(problem, start)]
    alone, values = list(common), {}
    for log, indices in members.items():
        part = _of_one_log(problem, indices)
        own = start[problem.size :].reshape(len(problem.data.trials), problem.own_size)[indices]
        end = minimise(
            part,
            np.concatenate([start[: problem.size], own.ravel()]),
            tolerance=numerics.FIT_TOLERANCE,
            evaluations=numerics.FIT_EVALUATIONS,
        )
        for index, (residual, _) in zip(indices, unseen_residuals(part, end), strict=True):
            alone[index] = _mean_square(residual)
        values[log] = part.attached(part.parameters(end))
    before, after = np.log(np.array([common, alone]))
    if not decide.beats(after, before, np.arange(len(before))):
        return []
    texts = []
    for number, effect in enumerate(joint.effects):
        held = {parameter.name for parameter in effect.effect.parameters if parameter.held}
        for index, parameter in enumerate(effect.effect.parameters):
            if parameter.name in held or not effect.values[index]:
                continue
            sizes = ", ".join(f"{values[log][number].values[index]:.3g} in {log}" for log in logs)
            texts.append(f"{parameter.name} of {effect_words(effect.effect.id)} {sizes}")
    return [f"{joint.isolated.joint.name} differs by log: {'; '.join(texts)}"]


def _of_one_log(problem: Problem, indices: Sequence[int]) -> Problem:
    """Return the problem of the trials of one log, whose conditions are numbered anew."""
    part = problem.part(indices)
    groups = list(dict.fromkeys(trial.group for trial in part.data.trials))
    trials = tuple(replace(trial, group=groups.index(trial.group)) for trial in part.data.trials)
    labels = tuple(part.data.conditions[group] for group in groups)
    return replace(part, data=replace(part.data, trials=trials, conditions=labels))


def _mean_square(residual: FloatArray) -> float:
    return float(np.mean(np.square(residual)))
