"""The geometry of the six-bar linkage: how angles turn its bodies, and how far they leave its loop open."""

import numpy as np
from scipy.spatial.transform import Rotation

from labrun.devices import FloatArray

JOINTS = tuple(f"theta_{number}" for number in range(1, 7))
BODIES = tuple(f"body_{number}" for number in range(1, 7))
_AXES_DEG = (0.0, -142.6, 35.3, 197.4, 77.9, 177.4)
"""Direction of each joint's axis in the flat sheet; all axes meet in one point."""


def body_turns(angles: FloatArray) -> dict[str, Rotation]:
    """Return how the bodies are turned against the flat sheet, body 4 along the branch 1-2-3-4.

    Parameters
    ----------
    angles : (samples, 6)
        rad, in the order of `JOINTS`.
    """
    branch, other = _branches(angles)
    return {"body_1": Rotation.identity(len(angles)), **other, **branch}


def loop_opening(angles: FloatArray) -> FloatArray:
    """Return the angle between body 4 as both branches place it, shape (samples,), rad; `angles` as in `body_turns`."""
    branch, other = _branches(angles)
    return np.asarray((branch["body_4"].inv() * other["body_4"]).magnitude())


def _branches(angles: FloatArray) -> tuple[dict[str, Rotation], dict[str, Rotation]]:
    """Return the bodies of the branches 1-2-3-4 and 1-6-5-4."""
    directions = np.radians(_AXES_DEG)
    axes = np.column_stack([np.cos(directions), np.sin(directions), np.zeros(6)])
    one_to_two, one_to_six, two_to_three, six_to_five, three_to_four, five_to_four = (
        Rotation.from_rotvec(column[:, None] * axis) for column, axis in zip(angles.T, axes, strict=True)
    )
    body_3, body_5 = one_to_two * two_to_three, one_to_six * six_to_five
    return (
        {"body_2": one_to_two, "body_3": body_3, "body_4": body_3 * three_to_four},
        {"body_6": one_to_six, "body_5": body_5, "body_4": body_5 * five_to_four},
    )
