"""All that was found at single joints, in the model of the whole robot, which is simulated beside the log."""

import time
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import LabrunError
from labrun.gap import numerics
from labrun.gap.diagnosis import Diagnosis
from labrun.gap.robot.diagnosis import OF_THE_LOG, OF_THE_WHOLE, JointDiagnosis, OfTheWhole, RobotDiagnosis
from labrun.gap.robot.one_joint import OneJoint, Prescribed
from labrun.models import Model, simulate, suggest_substeps

IN_THE_ROBOT: Mapping[str, Mapping[str, str]] = {
    "gravity-tilt": {"base_roll": "roll", "base_pitch": "pitch"},
    "gravity-compensation": {"gravity_compensation": "share"},
    "payload": {"tip_load": "mass", "tip_load_x": "x", "tip_load_y": "y", "tip_load_z": "z"},
}
"""Their parameters in the model of the whole robot, and what these are called in the effect."""


def together(
    prescribed: Prescribed,
    answers: Sequence[tuple[OneJoint, Diagnosis]],
    whole: Sequence[OfTheWhole],
    start: float,
) -> RobotDiagnosis:
    """Return what was found at all joints, and how well the model of the whole robot simulates the log with it.

    Parameters
    ----------
    whole
        What the robot as a whole has; a tilt or a load goes into the model if the log is simulated better with it.
    start
        When the diagnosis began, on the clock of `time.perf_counter`.
    """
    model = prescribed.whole
    names = {parameter.name for parameter in model.parameters}
    recalibrated, corrected = _values(model, answers, after=False), _values(model, answers, after=True)
    effects, left = [], []
    for _, answer in answers:
        for effect in answer.effects:
            try:
                effect.check(model)
                effects.append(effect)
            except LabrunError as error:
                if effect.effect.id not in OF_THE_WHOLE:
                    left.append(f"{effect.effect.id} at {effect.site} is not in the corrected model: {error}")
    effects += [
        prescribed.clock_at(actuator.input) for actuator in prescribed.robot.actuators if prescribed.lead_s
    ]
    before, after, last = (
        _errors(prescribed, model.with_values(values).with_effects(added))
        for values, added in (({}, ()), (recalibrated, ()), (corrected, tuple(effects)))
    )
    for name, told_by, values in whole:
        if name in OF_THE_LOG:
            continue
        put = {parameter: values[key] for parameter, key in IN_THE_ROBOT[name].items() if parameter in names}
        with_it = _errors(prescribed, model.with_values(corrected | put).with_effects(effects))
        if len(put) == len(values) and np.sum(np.square(with_it / after)) < np.sum(np.square(last / after)):
            corrected, last = corrected | put, with_it
        else:
            left.append(
                f"{name} is told by {', '.join(told_by)} and is not in the corrected model: with it the whole robot "
                "is simulated no better"
            )
    fall = [joint.joint.name for joint, _ in answers if joint.by_torque]
    if fall:
        left.append(
            f"{', '.join(fall)}: driven by the torque that was logged; nothing holds the whole robot there, so that "
            "its simulation drifts from the log, and how far says little"
        )
    recalibrations: dict[str, list[float]] = {}
    for _, answer in answers:
        for name, (_, _, value) in answer.recalibration.items():
            recalibrations.setdefault(name, []).append(value)
    agreed = {name: float(np.median(values)) for name, values in recalibrations.items()}
    joints = tuple(
        JointDiagnosis(
            joint.joint, answer, float(before[index]), float(after[index]), float(last[index]), agreed
        )
        for index, (joint, answer) in enumerate(answers)
    )
    return RobotDiagnosis(
        prescribed.robot.name, model.name, str(prescribed.dataset.source), joints, tuple(whole), tuple(effects),
        {name: value for name, value in corrected.items() if name in names}, tuple(left), time.perf_counter() - start,
    )  # fmt: skip


def _values(model: Model, answers: Sequence[tuple[OneJoint, Diagnosis]], *, after: bool) -> dict[str, float]:
    """Return the parameters of the whole robot: a joint's own from that joint, a mass as the mean over joints."""
    of_joints = []
    for _, answer in answers:
        stated = {name: value for name, (value, _, _) in answer.recalibration.items()}
        values = {name: value for name, (_, _, value) in answer.recalibration.items()}
        values |= answer.corrected if after else {}
        of_joints.append(with_rate_gain_as_damping(values, stated))
    return parameters_of_robot(model, of_joints)


def parameters_of_robot(model: Model, of_joints: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the parameters of the whole robot from those of its joints, each modelled by itself.

    A mass, of which joints have the ratio to what is stated, is the mean over the joints that have it.
    """
    stated = {parameter.name: parameter.value for parameter in model.parameters}
    collected: dict[str, list[float]] = {}
    for values in of_joints:
        for name, value in values.items():
            if name in stated:
                collected[name] = [value]
            elif (mass := name.removesuffix("_ratio")) in stated:
                collected.setdefault(mass, []).append(value * stated[mass])
    return {name: float(np.mean(values)) for name, values in collected.items()}


def with_rate_gain_as_damping(values: Mapping[str, float], stated: Mapping[str, float]) -> dict[str, float]:
    """Return a joint's parameters in which damping has what its servo's rate gain changed by.

    The whole robot has their sum in one place.
    """
    sums = {name: value for name, value in values.items() if not name.endswith("_kv")}
    damping = next((name for name in stated if name.endswith("_damping")), None)
    for name in values:
        if damping is not None and name not in sums:
            sums[damping] = max(sums.get(damping, stated[damping]) + values[name] - stated[name], 0.0)
    return sums


def _errors(prescribed: Prescribed, model: Model) -> FloatArray:
    """Return the root mean square of measured minus simulated of every joint, whole trials simulated at once."""
    data = prescribed.dataset
    names = [output.name for output in data.outputs]
    columns = [names.index(joint.output) for joint in prescribed.robot.joints]
    model = model.with_between({signal.name: signal.between for signal in data.inputs})
    squares, count, substeps = np.zeros(len(columns)), 0, None
    for trial, (q, rate, _) in zip(data.trials, prescribed.motions, strict=True):
        known = dict(zip(names, trial.outputs[0].tolist(), strict=True))
        known |= {joint.output: float(q[0, k]) for k, joint in enumerate(prescribed.robot.joints)}
        known |= {
            f"{joint.output}_rate": float(rate[0, k]) for k, joint in enumerate(prescribed.robot.joints)
        }
        begin = np.array([known.get(state, 0.0) for state in model.states])
        if substeps is None:
            substeps = suggest_substeps(
                model,
                trial.time_s[:50],
                trial.inputs[:50],
                initial_state=begin,
                tolerance=1e-3,
                most=numerics.ROBOT_SUBSTEPS,
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
