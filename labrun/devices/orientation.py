"""Angles from orientations of tracked bodies: a turn about an axis, a hinge between two bodies, Euler angles.

Quaternions are (x, y, z, w), and turn from a body's frame to the room's. One and its negative are the same orientation,
and all angles here are the same for both: the sign of an angle is that of the turn about the declared axis, and goes on
through zero, where an angle taken from the scalar part alone would be reflected.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from labrun.arrays import FloatArray
from labrun.devices.samples import Channel

Order = Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]
_EVEN = ("xyz", "yzx", "zxy")


class HingeAngle(BaseModel):
    """A joint's angle: the turn of one body against another about the hinge's axis.

    Attributes
    ----------
    from_body, to_body
        Tracked bodies. ``from`` left out is the room.
    axis
        Of the hinge, in the frame of ``from``; the bodies' frames are alike where the angle is 0.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    from_body: str | None = Field(default=None, alias="from")
    to_body: str = Field(alias="to")
    axis: tuple[float, float, float]

    @field_validator("axis")
    @classmethod
    def _has_direction(cls, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        if not any(axis):
            raise ValueError("expected a direction; [0, 0, 0] has none")
        return axis


class EulerAngles(BaseModel):
    """Three angles of a body, about axes of its own frame one after the other.

    Attributes
    ----------
    body
        A tracked body.
    from_body
        The body against which it turns; ``from`` left out is the room.
    order
        ``"xyz"`` is R = Rx Ry Rz.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    body: str
    from_body: str | None = Field(default=None, alias="from")
    order: Order = "xyz"


def turn_about(quaternion: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the turn about an axis: the twist of the swing-twist decomposition.

    Parameters
    ----------
    quaternion : (n, 4)
    axis : (3,)
        Unit vector, fixed in the room.

    Returns
    -------
    (n,)
        rad, within +-pi.
    """
    angle = 2.0 * np.arctan2(quaternion[:, :3] @ axis, quaternion[:, 3])
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def against(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the orientation of one body in the frame of another, ``start^-1 end``, shape (n, 4)."""
    vector, scalar = -start[:, :3], start[:, 3:]
    turned = scalar * end[:, :3] + end[:, 3:] * vector + np.cross(vector, end[:, :3])
    rest = scalar * end[:, 3:] - np.sum(vector * end[:, :3], axis=1, keepdims=True)
    return np.concatenate([turned, rest], axis=1)


def euler(quaternion: FloatArray, order: Order) -> FloatArray:
    """Return the angles about the axes of `order`, in that order, rad, shape (n, 3).

    The middle one is within +-pi/2; where it is +-pi/2 only sum or difference of the others is determined.
    """
    matrix = _matrix(quaternion)
    i, j, k = ("xyz".index(axis) for axis in order)
    sign = 1.0 if order in _EVEN else -1.0
    first = np.arctan2(-sign * matrix[:, j, k], matrix[:, k, k])
    middle = np.arcsin(np.clip(sign * matrix[:, i, k], -1.0, 1.0))
    last = np.arctan2(-sign * matrix[:, i, j], matrix[:, i, i])
    return np.column_stack([first, middle, last])


def _matrix(quaternion: FloatArray) -> FloatArray:
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


class OrientationAngles:
    """Makes channels of joint and Euler angles from the orientations of a tracker's bodies.

    Parameters
    ----------
    bodies
        In the order of the orientations.
    hinges, eulers : name -> what is asked for

    Attributes
    ----------
    channels
        Hinges by their names, then ``<name>_rx``, ``_ry``, ``_rz`` of the Euler angles; rad.
    """

    def __init__(
        self, bodies: Sequence[str], hinges: Mapping[str, HingeAngle], eulers: Mapping[str, EulerAngles]
    ) -> None:
        places: dict[str | None, int | None] = {None: None, **{body: k for k, body in enumerate(bodies)}}
        self._hinges = [
            (
                places[hinge.from_body],
                places[hinge.to_body],
                np.array(hinge.axis) / np.linalg.norm(hinge.axis),
            )
            for hinge in hinges.values()
        ]
        self._eulers = [
            (places[angles.from_body], places[angles.body], angles.order) for angles in eulers.values()
        ]
        turns = [f"{name}_r{axis}" for name in eulers for axis in "xyz"]
        self.channels = tuple(Channel(name, "rad") for name in (*hinges, *turns))

    def of(self, orientations: FloatArray) -> FloatArray:
        """Return the angles, shape (n, channels), of orientations (n, bodies, 4)."""
        turned = [turn_about(_seen(orientations, *ends), axis)[:, None] for *ends, axis in self._hinges]
        for start, end, order in self._eulers:
            angles = euler(_seen(orientations, start, end), order)
            turned.append(angles[:, [order.index(axis) for axis in "xyz"]])
        return np.concatenate([np.empty((len(orientations), 0)), *turned], axis=1)


def unknown_bodies(
    bodies: Sequence[str], hinges: Mapping[str, HingeAngle], eulers: Mapping[str, EulerAngles]
) -> list[str]:
    """Return a message for every requested body that is not tracked."""
    asked = [(name, body) for name, hinge in hinges.items() for body in (hinge.from_body, hinge.to_body)]
    asked += [(name, body) for name, angles in eulers.items() for body in (angles.from_body, angles.body)]
    return [
        f"angle {name} is of body {body!r}, which is not among bodies {list(bodies)}"
        for name, body in asked
        if body is not None and body not in bodies
    ]


def _seen(orientations: FloatArray, start: int | None, end: int | None) -> FloatArray:
    body = orientations[:, end] if end is not None else orientations[:, 0]
    return body if start is None else against(orientations[:, start], body)
