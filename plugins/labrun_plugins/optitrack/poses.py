"""From a frame to a sample: poses, joint angles, and markers where they are asked for; or the reason why not."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labrun.devices import Channel, FloatArray, OrientationAngles, turn_about
from labrun_plugins.optitrack.frame import Frame
from labrun_plugins.optitrack.settings import OptiTrackSettings

_POSE = (("x", "m"), ("y", "m"), ("z", "m"), ("qx", "1"), ("qy", "1"), ("qz", "1"), ("qw", "1"))


def channels_of(settings: OptiTrackSettings) -> tuple[Channel, ...]:
    """Return what is measured, in the order of a sample: poses, angles, markers."""
    poses = [Channel(f"{body}_{part}", unit) for body in settings.bodies for part, unit in _POSE]
    places = [
        Channel(f"{body}_marker{number}_{part}", "m")
        for body in settings.bodies
        for number in range(1, settings.markers.get(body, 0) + 1)
        for part in "xyz"
    ]
    return (*poses, *BodyAngles(settings).channels, *places)


class BodyAngles:
    """All angles that the settings ask for: turns of a body, hinges between two, Euler angles.

    Attributes
    ----------
    channels
        In the order of `of`.
    """

    def __init__(self, settings: OptiTrackSettings) -> None:
        self._turns = [
            (settings.bodies.index(angle.body), np.array(angle.axis) / np.linalg.norm(angle.axis))
            for angle in settings.angles.values()
        ]
        self._between = OrientationAngles(settings.bodies, settings.joints, settings.euler)
        self.channels = (*(Channel(name, "rad") for name in settings.angles), *self._between.channels)

    def of(self, orientations: FloatArray) -> FloatArray:
        """Return the angles, shape (n, channels), of orientations (n, bodies, 4)."""
        turns = [turn_about(orientations[:, body], axis) for body, axis in self._turns]
        return np.column_stack([*turns, self._between.of(orientations)])


@dataclass(frozen=True, slots=True)
class Unseen:
    """Why a frame gives no sample: what was not measured in it."""

    body: str
    reason: str


class PoseReader:
    """Makes samples of frames.

    Parameters
    ----------
    settings
        What is asked for.
    """

    def __init__(self, settings: OptiTrackSettings) -> None:
        self.channels = channels_of(settings)
        markers = settings.markers
        self.with_markers = bool(markers)
        self._bodies = settings.bodies
        self._angles = BodyAngles(settings)
        self._markers = [
            (body, number) for body in self._bodies for number in range(1, markers.get(body, 0) + 1)
        ]
        self._ids: dict[str, int] = {}

    def bind(self, ids: Mapping[str, int]) -> None:
        """Take the numbers by which frames name the bodies."""
        self._ids = dict(ids)

    def sample(self, frame: Frame) -> FloatArray | Unseen:
        """Return the values of a frame, shape (channels,), or what was not measured in it."""
        found = {body.id: body for body in frame.bodies}
        poses = np.empty((len(self._bodies), 7))
        for row, name in enumerate(self._bodies):
            body = found.get(self._ids[name])
            if body is None:
                return Unseen(name, "is not in the frames")
            if not body.measured:
                return Unseen(name, "is not tracked")
            poses[row] = body.pose
        angles = self._angles.of(poses[None, :, 3:])[0]
        places: list[FloatArray] = []
        if self._markers:
            seen = {marker.id: marker for marker in frame.markers}
            for name, number in self._markers:
                marker = seen.get(self._ids[name] << 16 | number)
                if marker is None or not marker.measured:
                    return Unseen(name, f"has its marker {number} hidden")
                places.append(np.array(marker.position))
        return np.concatenate([poses.ravel(), angles, *places])
