"""Where a robot carries a load, from all joints at once by inverse dynamics.

One joint alone tells a product of mass and arm: a load beside the line of the last link looks like a link of another
mass there. What the drives put on the joints, less what the robot as stated asks for, is linear in the load's mass
and, about a place, in its place (Khalil, Gautier, Lemoine, ICRA 2007, 4943). Gains, dampings, armatures, masses and
friction, which are off as well, are fitted beside it, each held to its statement by its tolerance. They can stand in
for a part of the mass, which the joints' own diagnoses tell; the place is a ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria
from labrun.gap.robot.one_joint import GAIN_TOLERANCE, MASS_TOLERANCE, Prescribed
from labrun.models import TipLoad

_DIFFERENCE_M = 1e-3
"""Half the difference of places behind a slope: torques grow with the square of a place at most."""
_NUMBERS_A_TRIAL = 10
"""What a trial tells of a joint, independent of one another, however many its samples are: neighbours say the same."""
_LEAST_LEFT = 0.01
"""Part of what the drive puts on a joint that is left at the least: with masses and gains that are all nothing, nothing
would be."""


def place_of_load(found: Prescribed, tip: TipLoad) -> FloatArray | None:
    """Return the place of the load that explains most of what drives do beyond the robot as stated.

    Returns
    -------
    (3,)
        In the frame of the last body, m; None if what is beyond looks like no load.
    """
    parts = [_Joint.of(found, place, tip) for place in range(len(found.robot.joints))]
    mass, place = 0.0, tip.far_end
    reach = max(float(np.linalg.norm(place)), _DIFFERENCE_M)
    for _ in range(criteria.LOAD_STEPS):
        at, slopes = tip.torque(place), []
        for axis in np.eye(3):
            ends = [tip.torque(place + sign * _DIFFERENCE_M * axis) for sign in (-1.0, 1.0)]
            slopes.append((ends[1] - ends[0]) / (2.0 * _DIFFERENCE_M))
        moment = _fitted(parts, np.stack([at, *slopes], axis=2), mass, len(found.motions))
        mass = float(moment[0])
        if not np.isfinite(moment).all() or mass <= 0.0:
            return None
        place = place + np.clip(moment[1:] / mass, -reach, reach)
    return place


@dataclass(frozen=True)
class _Joint:
    """What one joint says: ``left = columns @ unknowns + bodies @ errors of their masses + load``.

    Attributes
    ----------
    left : (n,)
        What the drive puts on the joint beyond what the robot as stated asks for.
    least : float
        Deviation of what is left that no fit goes below.
    columns, spread : (n, own), (own,)
        Of what the joint has of its own, and how far each may be off. First, for the gains of its drive, all that is
        asked of it: what it exerts itself is as noisy as the difference of goal and angle.
    bodies : (n, bodies)
        What each body asks of the joint, but for the last one: what that is off by counts as load.
    """

    left: FloatArray
    least: float
    columns: FloatArray
    spread: FloatArray
    bodies: FloatArray

    @classmethod
    def of(cls, found: Prescribed, place: int, tip: TipLoad) -> "_Joint":
        own, joint, data = found.own, found.robot.joints[place], found.dataset
        q, rate, acceleration = (
            np.concatenate([one[k][:, place] for one in found.motions]) for k in range(3)
        )
        drive = next((one for one in found.robot.actuators if one.joint == joint.name), None)
        effort, late = np.zeros_like(q), np.zeros_like(q)
        if drive is not None:
            told = np.concatenate([one.inputs for one in data.trials])
            goal = told[:, [one.name for one in data.inputs].index(drive.input)]
            late = _rates(found, goal)  # a goal that is held from sample to sample is late by half of one
            gains = own.drives[joint.name]
            if drive.command in ("torque", "geared"):
                effort = gains.gear * goal
            elif drive.command == "velocity":
                effort = gains.kp * (goal - rate)
            else:
                effort = gains.kp * (goal - q) - gains.kv * rate
            effort = np.clip(effort, *gains.limits)
        passive = own.damping[place] * rate + own.armature[place] * acceleration
        passive += own.stiffness[place] * (q - own.rest[place]) + own.friction[place] * np.sign(rate)
        masses = np.concatenate(
            [
                one.torque[:, place] + one.inertia[:, place] * motion[2][:, place, None]
                for one, motion in zip(found.terms, found.motions, strict=True)
            ]
        )
        asked = passive + masses.sum(axis=1)
        left = effort - asked
        if found.around:
            left = left - np.concatenate([one[:, place] for one in found.around])
        columns = np.column_stack(
            [asked, rate, np.sign(rate), np.ones_like(q), late, own.armature[place] * acceleration]
        )
        spread = np.array([GAIN_TOLERANCE, np.inf, np.inf, np.inf, np.inf, MASS_TOLERANCE])
        least = max(_LEAST_LEFT * float(np.std(effort if drive is not None else left)), 1e-12)
        others = [number for number, body in enumerate(found.terms[0].bodies) if body != tip.body]
        return cls(left, least, columns, spread, masses[:, others])


def _rates(found: Prescribed, values: FloatArray) -> FloatArray:
    """Return how fast a signal changes, trial by trial."""
    parts = np.split(values, np.cumsum([len(one.time_s) for one in found.dataset.trials])[:-1])
    trials = found.dataset.trials
    return np.concatenate(
        [np.gradient(part, trial.time_s) for part, trial in zip(parts, trials, strict=True)]
    )


def _fitted(joints: Sequence[_Joint], load: FloatArray, mass_kg: float, trials: int) -> FloatArray:
    """Return the load's mass, and mass times displacement of its place, shape (4,); `mass_kg` is known of it so far.

    Each joint counts in units of what is left at it, which is found by repetition.
    """
    count, own = joints[0].bodies.shape[1], joints[0].columns.shape[1]
    size, share = 4 + count + own * len(joints), min(_NUMBERS_A_TRIAL * trials / len(load), 1.0)
    deviations = [max(float(np.std(one.left)), one.least) for one in joints]
    found = np.zeros(size)
    for _ in range(criteria.LOAD_STEPS):
        normal, right = np.zeros((size, size)), np.zeros(size)
        normal[range(4, 4 + count), range(4, 4 + count)] = 1.0 / MASS_TOLERANCE**2
        rows = []
        for place, (one, deviation) in enumerate(zip(joints, deviations, strict=True)):
            first = 4 + count + own * place
            row = np.zeros((len(one.left), size))
            row[:, :4], row[:, 4 : 4 + count] = load[:, place], one.bodies
            row[:, first : first + own] = one.columns
            row[:, first] += mass_kg * load[:, place, 0]
            rows.append(row)
            normal += share * row.T @ row / deviation**2
            right += share * row.T @ one.left / deviation**2
            held = range(first, first + own)
            normal[held, held] += 1.0 / one.spread**2
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        found = scale * np.linalg.lstsq(normal * scale * scale[:, None], right * scale, rcond=1e-10)[0]
        deviations = [
            max(float(np.std(one.left - row @ found)), one.least)
            for one, row in zip(joints, rows, strict=True)
        ]
    return found[:4]
