"""How far parameters of a diagnosed robot may be off: every joint fitted once more by itself, its trials resampled.

A fit of the whole robot simulates all of it for every parameter of every joint; a joint alone moves by its own only.
What joints share, such as a mass, is told by the one that knows it best.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from labrun.effects import AttachedEffect
from labrun.estimate import Estimate
from labrun.fit import Dataset, Note, fit_model, silent
from labrun.gap.robot.diagnose import among
from labrun.gap.robot.diagnosis import OF_THE_LOG, OF_THE_WHOLE
from labrun.gap.robot.links import beside_encoders
from labrun.gap.robot.one_joint import OneJoint, Prescribed, one_joint, prescribed
from labrun.gap.saving import effects_of
from labrun.models import Model, Robot


def parameter_ranges(
    robot: Robot, model: Model, dataset: Dataset, diagnosis: Mapping[str, Any], *, note: Note = silent
) -> dict[str, Estimate]:
    """Return parameters of the model of the whole robot with 95 % intervals, from resampled trials.

    Fitted from what the diagnosis found, beside its causes, whose sizes stay; what is stated of each parameter holds it
    there by its tolerance.

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
    stated = {parameter.name: parameter.value for parameter in model.parameters}
    corrected = model.with_values(diagnosis["corrected"])
    masses = {
        f"{parameter.name}_ratio": (parameter.name, parameter.value / stated[parameter.name])
        for parameter in corrected.parameters
        if parameter.name.endswith("_mass") and stated[parameter.name]
    }
    answers = {joint["joint"]: joint["diagnosis"] for joint in diagnosis["joints"]}
    estimates: dict[str, Estimate] = {}
    around = as_diagnosed(prescribed(robot, corrected, dataset), diagnosis, answers)
    for index, joint in enumerate(robot.joints):
        isolated = one_joint(around, index)
        carried = {
            each.name: masses[each.name][1] for each in isolated.model.parameters if each.name in masses
        }
        start = isolated.model.with_values(carried)
        # a rate gain that the whole robot has not is in its damping: see `_into_damping`
        parameters = tuple(
            each if each.name in stated or each.name in masses else replace(each, tolerance=0.0)
            for each in start.parameters
        )
        if all(each.tolerance == 0.0 for each in parameters):
            continue
        note(f"{index + 1} of {len(robot.joints)} joints: {joint.name}")
        own = [each for each in effects_of(answers[joint.name]) if each.effect.id not in OF_THE_WHOLE]
        alone = replace(start, parameters=parameters).with_effects(own)
        fitted = fit_model(alone, isolated.dataset, rng=np.random.default_rng(diagnosis["seed"]), starts=1)
        for name, parameter in fitted.parameters.items():
            whole, estimate = name, parameter
            if name in masses:
                whole = masses[name][0]
                value, low, high = (stated[whole] * each for each in (parameter.value, *parameter.ci95))
                estimate = Estimate(value, (low, high), "kg")
            if whole not in estimates or np.ptp(estimate.ci95) < np.ptp(estimates[whole].ci95):
                estimates[whole] = estimate
    return estimates


def as_diagnosed(
    known: Prescribed, diagnosis: Mapping[str, Any], answers: Mapping[str, Mapping[str, Any]]
) -> Prescribed:
    """Return what is prescribed with the clock, the base, the load and the links as the diagnosis has them."""
    whole = [(entry["effect"], tuple(entry["joints"]), entry["values"]) for entry in diagnosis["whole"]]
    for name, _, values in whole:
        if name in OF_THE_LOG:
            (lead_s,) = values.values()
            known = known.led(-lead_s if name == "delay" else lead_s)
    joints: list[tuple[OneJoint, tuple[AttachedEffect, ...], Mapping[str, float]]] = []
    for index, joint in enumerate(known.robot.joints):
        answer = answers[joint.name]
        joints.append((one_joint(known, index), effects_of(answer), answer["corrected"]))
    return among(known.with_links(beside_encoders(known, joints)), whole)
