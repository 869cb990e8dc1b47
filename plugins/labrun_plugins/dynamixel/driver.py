"""Dynamixels that measure as well: where the joints are, and a stream of samples between the commands."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import DeviceContext, FloatArray, Health, Samples, streaming
from labrun.devices.compiled import BUSY, HALT, CompiledWire
from labrun.devices.listening import Listener, Newest, SampleBuffer
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.control_table import (
    LOAD_UNIT,
    MOTION,
    PRESENT_CURRENT,
    PRESENT_POSITION,
    PRESENT_VELOCITY,
    SPEED_UNIT_RAD_S,
)
from labrun_plugins.dynamixel.servos import DynamixelServos
from labrun_plugins.dynamixel.settings import DynamixelSettings

_NAP_S = 0.02
_BUSY_S = 0.005


class DynamixelWithFeedback(DynamixelServos):
    """Actuator and sensor on one bus.

    One group read a sample; the device time is that of the first servo's millisecond counter. A sample that a servo did
    not answer, and one that was due while the bus was still busy with another, count as lost.

    Attributes
    ----------
    channels
        ``<joint>_angle`` (rad), ``<joint>_speed`` (rad/s), ``<joint>_current`` (A) or ``<joint>_load`` (share of PWM).
    rate_hz
        Samples a second.
    """

    def __init__(self, name: str, settings: DynamixelSettings, context: DeviceContext) -> None:
        super().__init__(name, settings, context)
        self.channels = settings.channels()
        self.rate_hz = settings.feedback_hz
        self._buffer = SampleBuffer(len(self.channels))
        self._listener = Listener(name, self._receive)
        self._due_s = 0.0
        self._lent: CompiledWire | None = None
        self._lent_joints: tuple[str, ...] = ()
        self._heard = 0

    def open(self) -> None:
        """Connect, see `DynamixelServos.open`."""
        super().open()
        self._listener = Listener(self.name, self._receive)  # what the last one met is over

    def start(self) -> None:
        """Begin to stream; samples from before are dropped."""
        self._require_open()
        self._listener.stop()
        self._buffer.clear()
        self._due_s = self._clock.now()
        self._listener.start()

    def read(self) -> Samples:
        """Return all samples since the last call.

        Raises DeviceError: not streaming, a servo fell silent or has shut down, or the port is gone.
        """
        self._listener.check()
        streaming(self.name, self._listener.running)
        return self._buffer.take()

    def stop(self) -> None:
        """End the stream."""
        self._listener.stop()

    def show(self, newest: Newest | None) -> None:
        """Put every sample there, too, as it comes; None ends it."""
        self._buffer.newest = newest

    def prepare(self) -> None:
        """Have the sending of set-points compiled."""
        from labrun_plugins.dynamixel.compiled_sending import SENDING

        _ = SENDING.address

    def hand_over(self, joints: Sequence[str], angles_rad: FloatArray, rate_hz: float) -> CompiledWire:
        """Let a compiled loop send set-points, and ask for the measurements between them; see `HandingOver`.

        Nothing else is said on the bus meanwhile: temperatures are not asked for. A servo that shuts down says so in
        every answer.
        """
        from labrun_plugins.dynamixel.compiled_sending import wire_of

        self._require_open()
        self._check_threads()
        stops = self._stops
        begun = dict(zip(joints, angles_rad, strict=True))
        here = self.pose()
        first = np.array([begun[joint] for joint in self.joints])
        self._check.beginning(self.joints, first, np.array([here[joint] for joint in self.joints]))
        if not self._energised:
            self._energise()
        identities = dict(zip(self.joints, self._ids, strict=True))
        scales = [(identities[joint], self._scales[identities[joint]]) for joint in joints]
        question = self._bus.question(self._ids, MOTION)
        with self._gate:
            self._stream.halt()
            wire = wire_of(
                self._bus.file, self._settings, scales, angles_rad, rate_hz, question, self._clock.now()
            )
            if self._stops == stops:
                self._granted = stops
            else:
                wire.state[HALT] = 1.0
            self._heard, self._lent_joints, self._lent = 0, tuple(joints), wire
        return wire

    def take_back(self) -> None:
        """Send and ask again; measurements that were asked for and did not come count as lost."""
        from labrun_plugins.dynamixel.compiled_sending import asked

        wire, self._lent = self._lent, None
        if wire is None or not self._bus.is_open:
            return
        self._buffer.count_lost(max(0, asked(wire) - self._heard))
        self._due_s = self._clock.now()
        self._bus.spoken()
        self._check.forget()
        self._stream.start()

    def pose(self) -> Mapping[str, float]:
        """Return the measured angles, rad, see `DynamixelServos.pose`; those heard last while a loop has the bus."""
        if not self._looping:
            return super().pose()
        self._check_threads()
        counts = self._measurement.last()
        return {
            joint: self._scales[identity].angle_rad(counts[identity])
            for joint, identity in zip(self.joints, self._ids, strict=True)
        }

    def health(self) -> Health:
        """Ask every servo, see `DynamixelServos.health`; while a loop has the bus nothing is asked."""
        if not self._looping:
            return super().health()
        self._check_threads()
        return Health(notes=("a loop has the bus: temperatures are not asked for",))

    def safe_stop(self) -> None:
        """Stop, see `DynamixelServos.safe_stop`: a loop that has the bus sends nothing from now on."""
        wire = self._lent
        if wire is not None:
            wire.state[HALT] = 1.0
            until_s = self._clock.now() + _BUSY_S
            while wire.state[BUSY] and self._clock.now() < until_s:
                pass
        super().safe_stop()

    def close(self) -> None:
        """Disconnect; the stream ends."""
        self.take_back()
        self._listener.stop()
        super().close()

    @property
    def _looping(self) -> bool:
        """Tell whether a loop has the bus."""
        return self._lent is not None and not self._lent.state[HALT]

    def _idle(self) -> None:
        if not self._looping:
            super()._idle()

    def _last_set_point(self) -> FloatArray | None:
        from labrun_plugins.dynamixel.compiled_sending import ANGLES

        wire = self._lent
        if wire is None:
            return super()._last_set_point()
        last = dict(zip(self._lent_joints, wire.state[ANGLES:], strict=True))
        return np.array([last[joint] for joint in self.joints])

    def _check_threads(self) -> None:
        super()._check_threads()
        self._listener.check()

    def _receive(self) -> None:
        """Wait for the time of the next sample, and take it."""
        if self._looping:
            answered = self._measurement.hear()
            if answered is not None:
                self._heard += 1
                self._keep(*answered)
            return
        left_s = self._due_s - self._clock.now()
        if left_s > 0.0:
            self._clock.sleep(min(left_s, _NAP_S))
            if left_s > _NAP_S:
                return
        period_s = 1.0 / self.rate_hz
        late = int(max(0.0, self._clock.now() - self._due_s) / period_s)
        self._due_s += (late + 1) * period_s
        self._buffer.count_lost(late)
        taken = self._measurement.take()
        if taken is None:
            self._buffer.count_lost(1)
            return
        self._keep(*taken)

    def _keep(self, received_s: float, answers: dict[int, Status]) -> None:
        device_s = self._measurement.device_s[self._ids[0]]
        self._buffer.put(device_s, received_s, self._values(answers))

    def _values(self, answers: dict[int, Status]) -> list[float]:
        values: list[float] = []
        for servo in self._servos:
            data = answers[servo.id].data
            units: dict[str, Any] = {
                "angle": self._scales[servo.id].angle_rad(PRESENT_POSITION.within(MOTION, data)),
                "speed": self._scales[servo.id].sign
                * SPEED_UNIT_RAD_S
                * PRESENT_VELOCITY.within(MOTION, data),
                "current": self._scales[servo.id].sign
                * (servo.model.current_a or 0.0)
                * PRESENT_CURRENT.within(MOTION, data),
                "load": self._scales[servo.id].sign * LOAD_UNIT * PRESENT_CURRENT.within(MOTION, data),
            }
            values += [units[quantity] for quantity in self._settings.feedback]
        return values


class Dynamixel(DynamixelServos):
    """A bus of servos; with `feedback_hz` above zero it is a sensor as well, see `DynamixelWithFeedback`."""

    def __new__(cls, name: str, settings: DynamixelSettings, context: DeviceContext) -> DynamixelServos:  # type: ignore[misc]
        """Make the device, as a sensor too if the file asks for a stream of measurements."""
        if settings.feedback_hz > 0.0:
            return DynamixelWithFeedback(name, settings, context)
        return object.__new__(cls)
