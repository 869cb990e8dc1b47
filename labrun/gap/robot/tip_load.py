"""Where a robot carries a load, from all joints at once by inverse dynamics.

One joint alone tells a product of mass and arm: a load beside the line of the last link looks like a link of another
mass there. What the drives put on the joints, less what the robot as stated asks for, is linear in the load's mass
and, about a place, in its place (Khalil, Gautier, Lemoine, ICRA 2007, 4943). Gains, dampings, armatures, masses and
friction, which are off as well, are fitted beside it, each held to its statement by its tolerance. They can stand in
for a part of the mass, which the joints' own diagnoses tell; the place is a ratio.
"""

from collections.abc import Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria, numerics
from labrun.gap.robot.one_joint import Prescribed
from labrun.gap.robot.torques import JointTorque
from labrun.models import TipLoad

_DIFFERENCE_M = 1e-3
"""Half the difference of places behind a slope: torques grow with the square of a place at most."""


def place_of_load(prescribed: Prescribed, tip: TipLoad) -> FloatArray | None:
    """Return the place of the load that explains most of what drives do beyond the robot as stated.

    Returns
    -------
    (3,)
        In the frame of the last body, m; None if what is beyond looks like no load.
    """
    parts = [
        JointTorque.of(prescribed, index, without=tip.body).beside_late()
        for index in range(len(prescribed.robot.joints))
    ]
    mass, far_end = 0.0, tip.far_end
    reach = max(float(np.linalg.norm(far_end)), _DIFFERENCE_M)
    for _ in range(numerics.LOAD_STEPS):
        at, slopes = tip.torque(far_end), []
        for axis in np.eye(3):
            ends = [tip.torque(far_end + sign * _DIFFERENCE_M * axis) for sign in (-1.0, 1.0)]
            slopes.append((ends[1] - ends[0]) / (2.0 * _DIFFERENCE_M))
        moment = _fitted(parts, np.stack([at, *slopes], axis=2), mass, len(prescribed.motions))
        mass = float(moment[0])
        if not np.isfinite(moment).all() or mass <= 0.0:
            return None
        far_end = far_end + np.clip(moment[1:] / mass, -reach, reach)
    return far_end


def _fitted(joints: Sequence[JointTorque], load: FloatArray, mass_kg: float, trials: int) -> FloatArray:
    """Return the load's mass, and mass times displacement of its place, shape (4,); `mass_kg` is known of it so far.

    Each joint counts in units of what is left at it, which is found by repetition.
    """
    count, own = joints[0].bodies.shape[1], joints[0].columns.shape[1]
    size, share = 4 + count + own * len(joints), min(criteria.NUMBERS_A_TRIAL * trials / len(load), 1.0)
    deviations = [max(float(np.std(joint.left)), joint.least) for joint in joints]
    column = np.zeros(size)
    for _ in range(numerics.LOAD_STEPS):
        normal, right = np.zeros((size, size)), np.zeros(size)
        normal[range(4, 4 + count), range(4, 4 + count)] = 1.0 / criteria.MASS_TOLERANCE**2
        rows = []
        for index, (joint, deviation) in enumerate(zip(joints, deviations, strict=True)):
            first = 4 + count + own * index
            row = np.zeros((len(joint.left), size))
            row[:, :4], row[:, 4 : 4 + count] = load[:, index], joint.bodies
            row[:, first : first + own] = joint.columns
            row[:, first] += mass_kg * load[:, index, 0]
            rows.append(row)
            normal += share * row.T @ row / deviation**2
            right += share * row.T @ joint.left / deviation**2
            held = range(first, first + own)
            normal[held, held] += 1.0 / joint.spread**2
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        column = scale * np.linalg.lstsq(normal * scale * scale[:, None], right * scale, rcond=1e-10)[0]
        deviations = [
            max(float(np.std(joint.left - row @ column)), joint.least)
            for joint, row in zip(joints, rows, strict=True)
        ]
    return column[:4]
