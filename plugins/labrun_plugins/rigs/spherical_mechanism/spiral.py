"""The path of the source's chapter 4, and the analytic inverse of the mechanism, both on quaternions."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from pydantic import BaseModel, Field, PositiveFloat, ValidationError

from labrun.errors import SpecError
from labrun.models import native
from labrun.toml import Keys


class SpiralSettings(Keys):
    """Keys of `spm-spiral`.

    Attributes
    ----------
    turns, farthest_deg, period_s
        The end-effector's normal turns so often about the vertical while it leans out to `farthest_deg` and comes
        back, in `period_s`; then it begins again. The source states 30 s.
    """

    turns: PositiveFloat = 4.0
    farthest_deg: float = Field(default=30.0, gt=0.0, le=60.0)
    period_s: PositiveFloat = 30.0


class Spiral:
    """A spiral of the normal on the unit sphere, out and back, as the end-effector's quaternion (qw, qx, qy, qz).

    It leans out and back evenly, and turns evenly. The four numbers are those of the rotation that the mechanism
    without flaws has there, see `kinematics.rotation`.
    """

    Settings: ClassVar[type[BaseModel]] = SpiralSettings
    several: ClassVar[bool] = True

    def __init__(self, settings: Mapping[str, Any], condition: Mapping[str, float | str]) -> None:  # noqa: ARG002
        try:
            keys = SpiralSettings.model_validate(dict(settings))
        except ValidationError as error:
            raise SpecError(f"spm-spiral: {error.errors()[0]['msg']}") from error
        self._farthest = math.radians(keys.farthest_deg)
        self._turn = 2.0 * math.pi * keys.turns / keys.period_s
        self._period_s = keys.period_s

    def __call__(self, time_s: float) -> tuple[float, ...]:
        """Return the orientation at a time of the trial."""
        share = 2.0 * (time_s % self._period_s) / self._period_s
        lean = self._farthest * (share if share < 1.0 else 2.0 - share)
        turn = self._turn * time_s
        across = math.sin(lean)
        return orientation(across * math.cos(turn), across * math.sin(turn), math.cos(lean))


def orientation(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of the end-effector whose normal is (x, y, z), a unit vector with z > 0."""
    theta_2 = math.atan2(x, z)
    theta_1 = math.atan(y * z / (x * x + z * z))
    phi = -math.atan2(math.tan(theta_1), math.cos(theta_2))
    cy, sy, cx, sx = math.cos(theta_2 / 2), math.sin(theta_2 / 2), math.cos(phi / 2), math.sin(phi / 2)
    return cy * cx, cy * sx, sy * cx, -sy * sx


def servo_angles_deg(orientation: Sequence[float]) -> tuple[float, float]:
    """Return the servo angles for a quaternion (w, x, y, z): equations (4.5) to (4.7) for its third axis, deg."""
    w, x, y, z = orientation
    nx, ny, nz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    return math.degrees(math.atan2(ny * nz, nx * nx + nz * nz)), math.degrees(math.atan2(nx, nz))


def _compiled_angles(t: float, x: Any, u: Any, p: Any, force: Any, out: Any) -> None:  # noqa: ARG001
    """Servo angles, deg, as `servo_angles_deg`, of a quaternion (w, x, y, z) at `x`."""
    nx, ny = 2.0 * (x[1] * x[3] + x[0] * x[2]), 2.0 * (x[2] * x[3] - x[0] * x[1])
    nz = 1.0 - 2.0 * (x[1] * x[1] + x[2] * x[2])
    out[0] = math.degrees(math.atan2(ny * nz, nx * nx + nz * nz))
    out[1] = math.degrees(math.atan2(nx, nz))


servo_angles_deg.compiled = native("model", _compiled_angles)  # type: ignore[attr-defined]
