"""A motion over time, for one or more joints."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Joint angles over time, linear between the points.

    Attributes
    ----------
    joints
        Names of the joints, one a column of `angle_rad`.
    time_s : (n,)
        Seconds from the start of the motion, strictly increasing from 0.
    angle_rad : (n, joints)
        Commanded angles.
    period_s
        Length of one gait cycle; None for a motion that does not repeat.

    Raises
    ------
    ValueError
        Shapes that do not belong together, a time or an angle that is not a finite number, or times that do not
        increase: no such motion can be driven, or checked against a limit.
    """

    joints: tuple[str, ...]
    time_s: FloatArray
    angle_rad: FloatArray
    period_s: float | None = None

    def __post_init__(self) -> None:
        if self.angle_rad.shape != (len(self.time_s), len(self.joints)):
            raise ValueError(
                f"trajectory of {len(self.joints)} joints and {len(self.time_s)} points "
                f"has angles of shape {self.angle_rad.shape}"
            )
        times, angles = self.time_s, self.angle_rad
        if (
            (len(times) == 0 or (-np.inf < times[0] and times[-1] < np.inf))
            and (times[1:] > times[:-1]).all()
            and np.isfinite(angles).all()
        ):
            return
        if not np.isfinite(self.time_s).all():
            point = int(np.argmin(np.isfinite(self.time_s)))
            raise ValueError(f"trajectory has a time of {self.time_s[point]} s at point {point}")
        late = np.diff(self.time_s) <= 0.0
        if late.any():
            point = int(np.argmax(late))
            raise ValueError(
                f"trajectory has times that do not increase: "
                f"{self.time_s[point + 1]:g} s comes after {self.time_s[point]:g} s"
            )
        finite = np.isfinite(self.angle_rad)
        if not finite.all():
            point, column = (int(i) for i in np.argwhere(~finite)[0])
            raise ValueError(
                f"trajectory has an angle of {self.angle_rad[point, column]} rad "
                f"for joint {self.joints[column]} at {self.time_s[point]:g} s"
            )

    @property
    def duration_s(self) -> float:
        """Time of the last point."""
        return float(self.time_s[-1])

    def at(self, time_s: ArrayLike) -> FloatArray:
        """Return the angles at the given times, shape (n, joints); held before the first and after the last point."""
        times = np.atleast_1d(np.asarray(time_s, dtype=float))
        columns = [np.interp(times, self.time_s, column) for column in self.angle_rad.T]
        return np.column_stack(columns) if columns else np.empty((len(times), 0))

    def only(self, joints: tuple[str, ...]) -> "Trajectory":
        """Return the motion of these joints alone, in their order."""
        if joints == self.joints:
            return self
        columns = [self.joints.index(joint) for joint in joints]
        return Trajectory(joints, self.time_s, self.angle_rad[:, columns], self.period_s)

    def peak_speed_rad_s(self) -> FloatArray:
        """Return the greatest commanded speed of each joint, shape (joints,)."""
        if len(self.time_s) < 2:
            return np.zeros(len(self.joints))
        return np.asarray(
            np.max(np.abs(np.diff(self.angle_rad, axis=0) / np.diff(self.time_s)[:, None]), axis=0)
        )
