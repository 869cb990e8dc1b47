"""How far parameters of a diagnosed robot may be off: every joint fitted once more by itself, its trials resampled.

A fit of the whole robot simulates all of it for every parameter of every joint; a joint alone moves by its own only.
What joints share, such as a mass, is told by the one that knows it best.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from labrun.estimate import Estimate
from labrun.fit import Dataset, Note, fit_model, silent
from labrun.gap.robot.as_diagnosed import diagnosed_joints
from labrun.gap.robot.one_joint import prescribed
from labrun.gap.robot.torque_units import in_torques
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
    estimates: dict[str, Estimate] = {}
    joints = diagnosed_joints(prescribed(robot, corrected, in_torques(dataset, diagnosis)), diagnosis)
    for index, diagnosed in enumerate(joints):
        isolated = diagnosed.isolated
        carried = {
            each.name: masses[each.name][1] for each in isolated.model.parameters if each.name in masses
        }
        start = isolated.model.with_values(carried)
        # a rate gain that the whole robot has not is in its damping: see `with_rate_gain_as_damping`
        parameters = tuple(
            each if each.name in stated or each.name in masses else replace(each, tolerance=0.0)
            for each in start.parameters
        )
        if all(each.tolerance == 0.0 for each in parameters):
            continue
        note(f"{index + 1} of {len(robot.joints)} joints: {isolated.joint.name}")
        alone = replace(start, parameters=parameters).with_effects(diagnosed.effects)
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
