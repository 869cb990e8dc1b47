"""Stand-in for OptiTrack motion capture (two Prime 17W cameras, Motive)."""

import math
from typing import ClassVar

import numpy as np
from pydantic import NonNegativeFloat

from labrun.devices import DeviceContext, DeviceError, DeviceSettings, FloatArray, Samples
from labrun_plugins.optitrack.settings import OptiTrackSettings
from labrun_plugins.optitrack.stream import SEE_MARKERS, BodyAngles, channels_of
from labrun_plugins.simulated.device import Faults, SimulatedSettings
from labrun_plugins.simulated.sensor import SimulatedSensor, Timing

_POSITION_SD_M = 1.0e-4
_ORIENTATION_SD_RAD = 1.5e-3
_MARKER_RADIUS_M = 0.035
_POSE_CHANNELS = 7


class CaptureFaults(Faults):
    """Bad days of every simulated device, and of cameras.

    Attributes
    ----------
    lose_after_s
        From then on its bodies are not tracked, though it goes on to answer.
    """

    lose_after_s: NonNegativeFloat | None = None


class SimulatedOptiTrackSettings(OptiTrackSettings, SimulatedSettings):
    """Keys of the motion capture, and of every simulated device."""

    faults: CaptureFaults = CaptureFaults()


class SimulatedOptiTrack(SimulatedSensor):
    """Position with 0.1 mm noise, orientation with 1.5 mrad; a Prime 17W sends up to 360 frames/s, others 1000.

    The angle is what 0.1 mm makes of markers some 70 mm apart (both chosen: "sub-millimetre" is the claim).
    One frame in 2000 is lost and counted by the frame number. Latency is 5.5 ms, as in a capture of Motive's
    own time stamps; camera time is the device time.
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedOptiTrackSettings
    model = "OptiTrack Prime 17W, Motive (simulated)"

    def __init__(self, name: str, settings: SimulatedOptiTrackSettings, context: DeviceContext) -> None:
        self.bodies = settings.bodies
        self._lose_after_s = settings.faults.lose_after_s
        self._lost_tracking_s = settings.lost_tracking_s
        channels = channels_of(settings)
        self.feels = tuple(c.name for c in channels[: _POSE_CHANNELS * len(self.bodies)])
        self._markers = tuple(settings.markers.get(body, 0) for body in self.bodies)
        self._angles = BodyAngles(settings)
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
        """Connect. Raises DeviceError: a body is not to be seen on this bench."""
        self._require_signals(self.feels)
        super().open()

    def loses_at_s(self) -> float:
        """Return when it loses its bodies, by the clock; inf if it never does."""
        return math.inf if self._lose_after_s is None else self._require_open() + self._lose_after_s

    def _blind_from_s(self) -> float:
        return min(super()._blind_from_s(), self.loses_at_s())

    def _nothing_heard(self, now_s: float) -> Samples:
        lost_s = now_s - self.loses_at_s()
        if lost_s > self._lost_tracking_s and not self._silent():
            raise DeviceError(
                self.name, f"body {self.bodies[0]} is not tracked, for {lost_s:.2g} s now", hint=SEE_MARKERS
            )
        return super()._nothing_heard(now_s)

    def _measure(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        poses = self.scene.observe(self.feels, time_s).reshape(count, len(self.bodies), 7).copy()
        poses[:, :, :3] += _POSITION_SD_M * self._rng.standard_normal((count, len(self.bodies), 3))
        half_turn = 0.5 * _ORIENTATION_SD_RAD * self._rng.standard_normal((count, len(self.bodies), 3))
        poses[:, :, 3:] = _turned(poses[:, :, 3:], half_turn)
        return self._completed(poses)

    def _completed(self, poses: FloatArray) -> FloatArray:
        count = len(poses)
        angles = self._angles.of(poses[:, :, 3:])
        places = [
            poses[:, body, :3] + _turned_by(poses[:, body, 3:], offset)
            for body, markers in enumerate(self._markers)
            for offset in marker_places(markers)
        ]
        return np.column_stack([poses.reshape(count, -1), angles, *places])


def marker_places(count: int) -> FloatArray:
    """Return where the markers of a body are, from its centre, shape (count, 3): on a circle, unevenly (chosen)."""
    turn = 2 * np.pi * np.arange(count) ** 1.2 / max(count, 1) ** 1.2
    return _MARKER_RADIUS_M * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(count)])


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


def _turned_by(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Return a vector turned by unit quaternions (x, y, z, w), shape (n, 3)."""
    axis, scalar = quaternion[:, :3], quaternion[:, 3:]
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + scalar * across + np.cross(axis, across))
