"""The turn of a body about an axis."""

import numpy as np

from labrun.devices import FloatArray


def angle_about(quaternion: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the turn about an axis: the twist of the swing-twist decomposition.

    Parameters
    ----------
    quaternion : (n, 4)
        Orientations (x, y, z, w).
    axis : (3,)
        Unit vector, fixed in the room.

    Returns
    -------
    (n,)
        rad, within +-pi.
    """
    angle = 2.0 * np.arctan2(quaternion[:, :3] @ axis, quaternion[:, 3])
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
