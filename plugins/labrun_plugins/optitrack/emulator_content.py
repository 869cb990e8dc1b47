"""What the emulated Motive sees: the bodies of the simulated bench, and all the rest a real stream carries."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceContext, FloatArray
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.optitrack.emulator_wire import Analog, BodyDescription, Content, LabelledMarker, RigidBody
from labrun_plugins.simulated.optitrack import SimulatedOptiTrack, SimulatedOptiTrackSettings, marker_places

_MARKERS = 3
_FIRST_ID = 11
_RENUMBERED = 20
_DECOY = "wand"
_DECOY_ID = 1
_OCCLUDED = 0x01
_POSE = 7


class EmulatedCapture:
    """Bodies as the stand-in measures them, under numbers of their own, among other things."""

    def __init__(self, name: str, settings: SimulatedOptiTrackSettings, context: EmulatorContext) -> None:
        self._faults = context.faults
        counts = {body: settings.markers.get(body, _MARKERS) for body in settings.bodies}
        self._counts = [counts[body] for body in settings.bodies]
        self._names = settings.bodies
        self._camera = SimulatedOptiTrack(
            name,
            settings.model_copy(update={"markers": counts, "angles": {}, "joints": {}, "euler": {}}),
            DeviceContext(context.clock, context.rng, context.scene),
        )
        self._shift = 0
        self._last: dict[int, RigidBody] = {}

    def open(self) -> None:
        """Look at the bench; DeviceError if a body is not to be seen there."""
        self._camera.open()

    def renumber(self) -> None:
        """Give the bodies other numbers; one that had been a body's is the decoy's now."""
        self._shift += _RENUMBERED

    def descriptions(self) -> list[BodyDescription]:
        """Return the model's bodies."""
        described = [BodyDescription(_DECOY, self._decoy_id(), marker_places(4).tolist())]
        for index, name in enumerate(self._names):
            if self._faults.value("missing-body") in (True, name):
                continue
            described.append(
                BodyDescription(name, self._id(index), marker_places(self._counts[index]).tolist())
            )
        return described

    def measure(self, time_s: FloatArray) -> FloatArray:
        """Return poses and markers at these times, a row each."""
        values, _ = self._camera.measure(time_s)
        return values

    def content(self, number: int, row: FloatArray, **timing: Any) -> Content:
        """Return a frame."""
        count = len(self._names)
        poses = row[: _POSE * count].reshape(count, _POSE)
        places = row[_POSE * count :].reshape(-1, 3)
        bodies = [RigidBody(self._decoy_id(), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), 0.001)]
        markers = [LabelledMarker(self._decoy_id() << 16 | 1, (1.0, 2.0, 3.03))]
        first = 0
        for index, name in enumerate(self._names):
            own = places[first : first + self._counts[index]]
            first += self._counts[index]
            if self._faults.value("missing-body") in (True, name):
                continue
            lost = self._faults.value("tracking-lost") in (True, name)
            bodies.append(self._body(index, poses[index], lost))
            hidden = lost or self._faults.value("hidden-marker") in (True, name)
            markers += [
                LabelledMarker(
                    self._id(index) << 16 | turn + 1, slot.tolist(), params=0x0A | hidden * _OCCLUDED
                )
                for turn, slot in enumerate(own)
            ]
        return Content(
            number,
            bodies=bodies,
            marker_sets=[("all", places.tolist()), (_DECOY, [])],
            others=[(0.5, 0.5, 0.5)],
            skeletons=[(7, [RigidBody(1, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))])],
            assets=[
                (9, [RigidBody(2, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0))], [LabelledMarker(5, (0, 0, 0))])
            ],
            markers=markers,
            plates=[Analog(1, [(0.0, 0.1), (0.2, 0.3)])],
            devices=[Analog(2, [(1.5,)])],
            **timing,
        )

    def _body(self, index: int, pose: FloatArray, lost: bool) -> RigidBody:
        if lost and index in self._last:
            before = self._last[index]
            return RigidBody(self._id(index), before.position, before.orientation, before.error, 0)
        position: Sequence[float] = np.asarray(pose[:3]).tolist()
        body = RigidBody(self._id(index), position, pose[3:].tolist(), 0.0002, int(not lost))
        self._last[index] = body
        return body

    def _id(self, index: int) -> int:
        return _FIRST_ID + self._shift + index

    def _decoy_id(self) -> int:
        return _FIRST_ID + self._shift - _RENUMBERED if self._shift else _DECOY_ID
