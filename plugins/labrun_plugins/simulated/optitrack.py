"""Stand-in for OptiTrack motion capture (two Prime 17W cameras, Motive)."""

from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from labrun.devices import Channel, DeviceContext, DeviceSettings, FloatArray, Port
from labrun_plugins.simulated.sensor import SimulatedSensor
from labrun_plugins.simulated.settings import SimulatedSettings
from labrun_plugins.simulated.stream import Timing

_POSITION_SD_M = 1.0e-4
_ORIENTATION_SD_RAD = 1.5e-3
_POSE = (("x", "m"), ("y", "m"), ("z", "m"), ("qx", "1"), ("qy", "1"), ("qz", "1"), ("qw", "1"))


class Angle(BaseModel):
    """A joint angle taken from a body's orientation: its turn about `axis` (fixed in the room)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    body: str
    axis: tuple[float, float, float]

    @model_validator(mode="after")
    def _has_direction(self) -> "Angle":
        if not any(self.axis):
            raise ValueError("axis is a direction; [0, 0, 0] is none")
        return self


class OptiTrackSettings(SimulatedSettings):
    """Keys of the motion capture: `host` is the Motive computer; `angles` come from the bodies' poses."""

    host: Port
    rate_hz: float = Field(default=360.0, gt=0, le=360.0)
    bodies: tuple[str, ...] = Field(default=("arm",), min_length=1)
    angles: dict[str, Angle] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _angles_name_bodies(self) -> "OptiTrackSettings":
        for name, angle in self.angles.items():
            if angle.body not in self.bodies:
                raise ValueError(
                    f"angle {name} is of body {angle.body!r}, which is not among bodies {list(self.bodies)}"
                )
        return self


class SimulatedOptiTrack(SimulatedSensor):
    """Up to 360 frames/s: position with 0.1 mm noise, orientation with 1.5 mrad.

    The angle is what 0.1 mm makes of markers some 70 mm apart (both chosen: "sub-millimetre" is the claim).
    One frame in 2000 is lost and counted by the frame number. Latency is 5.5 ms, as in a capture of Motive's
    own time stamps; camera time is the device time.
    """

    Settings: ClassVar[type[DeviceSettings]] = OptiTrackSettings
    model = "OptiTrack Prime 17W, Motive (simulated)"

    def __init__(self, name: str, settings: OptiTrackSettings, context: DeviceContext) -> None:
        self.bodies = settings.bodies
        poses = tuple(Channel(f"{body}_{part}", unit) for body in self.bodies for part, unit in _POSE)
        self._pose_signals = tuple(channel.name for channel in poses)
        self._angles = [
            (self.bodies.index(angle.body), np.array(angle.axis) / np.linalg.norm(angle.axis))
            for angle in settings.angles.values()
        ]
        channels = poses + tuple(Channel(angle, "rad") for angle in settings.angles)
        timing = Timing(
            latency_s=0.0055, jitter_s=0.0005, lost_share=5e-4,
            clock_offset_s=float(context.rng.uniform(10, 1000)), clock_drift=-1e-5,
        )  # fmt: skip
        super().__init__(
            name, settings, context,
            channels=channels, rate_hz=settings.rate_hz, timing=timing, full_scale=np.full(len(channels),
            np.inf),
        )  # fmt: skip

    def open(self) -> None:
        """Connect.

        Raises
        ------
        DeviceError
            A body is not to be seen on this bench.
        """
        self._require_signals(self._pose_signals)
        super().open()

    def _measure(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        poses = self.scene.observe(self._pose_signals, time_s).reshape(count, len(self.bodies), 7).copy()
        poses[:, :, :3] += _POSITION_SD_M * self._rng.standard_normal((count, len(self.bodies), 3))
        half_turn = 0.5 * _ORIENTATION_SD_RAD * self._rng.standard_normal((count, len(self.bodies), 3))
        poses[:, :, 3:] = _turned(poses[:, :, 3:], half_turn)
        angles = [_angle_about(poses[:, body, 3:], axis) for body, axis in self._angles]
        return np.column_stack([poses.reshape(count, -1), *angles])


def _turned(quaternion: FloatArray, half_turn: FloatArray) -> FloatArray:
    """Return unit quaternions (x, y, z, w) turned by twice the small vector `half_turn` (rad)."""
    vector, scalar = quaternion[..., :3], quaternion[..., 3:]
    turned = np.concatenate(
        [
            vector + scalar * half_turn + np.cross(half_turn, vector),
            scalar - np.sum(half_turn * vector, axis=-1, keepdims=True),
        ],
        axis=-1,
    )
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def _angle_about(quaternion: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the turn about an axis (twist of the swing-twist decomposition), rad, within +-pi."""
    angle = 2.0 * np.arctan2(quaternion[:, :3] @ axis, quaternion[:, 3])
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
