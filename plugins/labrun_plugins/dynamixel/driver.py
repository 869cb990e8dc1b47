"""Dynamixels that measure as well: where the joints are, and a stream of samples between the commands."""

from typing import Any

from labrun.devices import DeviceContext, Samples, streaming
from labrun.devices.listening import Listener, SampleBuffer
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

    def close(self) -> None:
        """Disconnect; the stream ends."""
        self._listener.stop()
        super().close()

    def _check_threads(self) -> None:
        super()._check_threads()
        self._listener.check()

    def _receive(self) -> None:
        """Wait for the time of the next sample, and take it."""
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
