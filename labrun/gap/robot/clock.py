"""By how much the goals of a log are stamped late or early beside its angles, from all joints at once.

One logger stamps all joints: a clock that all of them share is simpler than one of each. Alone, a joint can mistake it
for damping, as a servo that knows its goal early lags less.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import LabrunError
from labrun.fit import silent
from labrun.gap import criteria, numerics
from labrun.gap.averaging import averaged
from labrun.gap.recalibration import recalibrate
from labrun.gap.robot.one_joint import Prescribed, one_joint
from labrun.gap.robot.torques import JointTorque
from labrun.gap.screening import Base

_NUDGE_S = 1e-3
"""Half of a step behind a slope of simulations."""


def common_lead(prescribed: Prescribed, rng: np.random.Generator) -> float:
    """Return by how much all goals are stamped late beside all angles, s; negative if the angles follow late.

    0.0 where joints tell no such time, or do not agree on one.
    """
    alone, deviations = _alone(prescribed)
    speaking = deviations < np.abs(alone) / criteria.CLOCK_TOLD
    if speaking.sum() < criteria.CLOCK_JOINTS:
        return 0.0
    middle = float(np.median(alone[speaking]))
    room = np.maximum(criteria.CLOCK_TOLD * deviations, criteria.CLOCK_ALIKE * abs(middle))
    asked = deviations < abs(middle) / criteria.CLOCK_TOLD
    agreeing = asked & (np.abs(alone - middle) <= room)
    if agreeing.sum() < max(criteria.CLOCK_JOINTS, criteria.CLOCK_AGREED * asked.sum()):
        return 0.0
    lead_s = float(np.average(alone[agreeing], weights=1.0 / np.square(deviations[agreeing])))
    if abs(lead_s) < criteria.CLOCK_LEAST * prescribed.sample_s:
        return 0.0
    return lead_s + _left_over(prescribed.led(lead_s), np.flatnonzero(agreeing), rng)


def _alone(prescribed: Prescribed) -> tuple[FloatArray, FloatArray]:
    """Return what each joint says by its torques, and its standard deviation, s; infinite where it says nothing."""
    leads, deviations = [], []
    share = min(
        criteria.NUMBERS_A_TRIAL
        * len(prescribed.motions)
        / sum(len(motion[0]) for motion in prescribed.motions),
        1.0,
    )
    for index in range(len(prescribed.robot.joints)):
        lead_s, sd_s, deviation = 0.0, np.inf, 0.0
        for _ in range(numerics.CLOCK_STEPS):
            torque = JointTorque.of(prescribed.led(lead_s), index)
            if not np.any(torque.late):
                break
            deviation = deviation or max(float(np.std(torque.left)), torque.least)
            columns = np.column_stack([torque.late, torque.columns, torque.bodies])
            spread = np.concatenate(
                [[np.inf], torque.spread, np.full(torque.bodies.shape[1], criteria.MASS_TOLERANCE)]
            )
            normal = share * columns.T @ columns / deviation**2 + np.diag(1.0 / np.square(spread))
            scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
            inverse = np.linalg.pinv(normal * scale * scale[:, None], rcond=1e-12, hermitian=True)
            fitted = scale * (inverse @ (scale * (share * columns.T @ torque.left / deviation**2)))
            deviation = max(float(np.std(torque.left - columns @ fitted)), torque.least)
            # what is left by goals at this time grows by `late` with every second that they are read further ahead
            lead_s -= float(
                np.clip(fitted[0], -numerics.CLOCK_FARTHEST_STEP_S, numerics.CLOCK_FARTHEST_STEP_S)
            )
            sd_s = float(scale[0] * np.sqrt(inverse[0, 0]))
        leads.append(lead_s)
        deviations.append(sd_s)
    return np.array(leads), np.array(deviations)


def _left_over(prescribed: Prescribed, joint_indices: Iterable[int], rng: np.random.Generator) -> float:
    """Return what is missing of a time, from joints simulated with their parameters recalibrated.

    Smoothing bends what inverse dynamics says of it, simulations do not. Each joint counts in units of what is left
    at it.
    """
    along, weight = 0.0, 0.0
    for index in joint_indices:
        joint, later = (
            one_joint(prescribed, int(index)),
            one_joint(prescribed.led(prescribed.lead_s + _NUDGE_S), int(index)),
        )
        try:
            fitted = recalibrate(joint.model, averaged(joint.dataset, joint.model), rng, silent)
            problem, z = fitted.problem, fitted.z
            base = Base.of(problem, z)
            nudged = replace(problem, model=later.model).residuals(z)
        except LabrunError:
            continue
        changes = [after - now for after, now in zip(nudged, base.residual, strict=True)]
        change = base.nuisance.remainder(changes) / _NUDGE_S
        left = base.nuisance.remainder(base.residual, problem.priors.residual(z))
        squares = max(float(left @ left), 1e-300)
        if np.isfinite(change).all() and np.isfinite(squares):
            along -= float(change @ left) / squares
            weight += float(change @ change) / squares
    return along / weight if weight > 0.0 else 0.0
