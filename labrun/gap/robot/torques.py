"""What the drives of a robot do along its measured motion beyond what the robot as stated asks of them.

By inverse dynamics, so that nothing is simulated: what is off by little (gains, dampings, masses, a load, a clock) is
linear in it (Khalil, Gautier, Lemoine, ICRA 2007, 4943).
"""

from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria
from labrun.gap.robot.one_joint import Prescribed
from labrun.models import RobotActuator

_DIFFERENCE_S = 1e-3
"""Half the difference of times behind a slope: drives do not change faster."""


@dataclass(frozen=True)
class JointTorque:
    """What one joint says: ``left = columns @ unknowns + bodies @ errors of their masses + what is looked for``.

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
        What each body asks of the joint.
    late : (n,)
        How `left` changes with the time by which goals are read ahead.
    """

    left: FloatArray
    least: float
    columns: FloatArray
    spread: FloatArray
    bodies: FloatArray
    late: FloatArray

    @classmethod
    def of(cls, prescribed: Prescribed, joint_index: int, *, without: str = "") -> "JointTorque":
        """Take what a joint says; of the body `without`, what its mass is off by is looked for elsewhere."""
        own, joint = prescribed.own, prescribed.robot.joints[joint_index]
        q, rate, acceleration = (
            np.concatenate([motion[k][:, joint_index] for motion in prescribed.motions]) for k in range(3)
        )
        drive = prescribed.drive(joint)
        effort, late = np.zeros_like(q), np.zeros_like(q)
        if drive is not None:
            effort, before, after = (
                _effort(prescribed, joint_index, drive, prescribed.lead_s + more)
                for more in (0.0, -_DIFFERENCE_S, _DIFFERENCE_S)
            )
            late = (after - before) / (2.0 * _DIFFERENCE_S)
        passive = own.damping[joint_index] * rate + own.armature[joint_index] * acceleration
        passive += own.stiffness[joint_index] * (q - own.rest[joint_index]) + own.friction[
            joint_index
        ] * np.sign(rate)
        masses = np.concatenate(
            [
                term.torque[:, joint_index] + term.inertia[:, joint_index] * motion[2][:, joint_index, None]
                for term, motion in zip(prescribed.terms, prescribed.motions, strict=True)
            ]
        )
        asked = passive + masses.sum(axis=1)
        left = effort - asked
        if prescribed.around:
            left = left - np.concatenate([torque[:, joint_index] for torque in prescribed.around])
        columns = np.column_stack(
            [asked, rate, np.sign(rate), np.ones_like(q), own.armature[joint_index] * acceleration]
        )
        spread = np.array([criteria.GAIN_TOLERANCE, np.inf, np.inf, np.inf, criteria.MASS_TOLERANCE])
        least = max(criteria.LEAST_TORQUE * float(np.std(effort if drive is not None else left)), 1e-12)
        others = [number for number, body in enumerate(prescribed.terms[0].bodies) if body != without]
        return cls(left, least, columns, spread, masses[:, others], late)

    def beside_late(self) -> "JointTorque":
        """Return the same with goals that may be late or early by any time of the joint's own."""
        columns = np.column_stack([self.columns, self.late])
        return replace(self, columns=columns, spread=np.append(self.spread, np.inf))


def _effort(prescribed: Prescribed, joint_index: int, drive: RobotActuator, ahead_s: float) -> FloatArray:
    """Return what the drive puts on its joint along the measured motion, goals read ahead, (n,)."""
    column = [signal.name for signal in prescribed.dataset.inputs].index(drive.input)
    gains = prescribed.own.drives[drive.joint]
    efforts = []
    for trial, (q, rate, _) in zip(prescribed.dataset.trials, prescribed.motions, strict=True):
        at_s = trial.time_s + ahead_s - prescribed.late_s(drive.input)
        goal = np.interp(at_s, trial.time_s, trial.inputs[:, column])
        if drive.command in ("torque", "geared"):
            efforts.append(gains.gear * goal)
        elif drive.command == "velocity":
            efforts.append(gains.kp * (goal - rate[:, joint_index]))
        else:
            efforts.append(gains.kp * (goal - q[:, joint_index]) - gains.kv * rate[:, joint_index])
    exerted: FloatArray = np.clip(np.concatenate(efforts), *gains.limits)
    return exerted
