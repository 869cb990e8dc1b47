"""Dynamixels that measure as well: where the joints are, and a stream of samples between the commands."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import Clock, DeviceContext, DeviceError, FloatArray, Health, Samples
from labrun.devices.compiled_wire import BUSY, HALT, CompiledWire
from labrun.devices.listening import Listener, Newest, SampleBuffer
from labrun_plugins.dynamixel.bus import TRIES, Bus
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.control_table import (
    LOAD_UNIT,
    MOTION,
    PRESENT_CURRENT,
    PRESENT_POSITION,
    PRESENT_VELOCITY,
    SPEED_UNIT_RAD_S,
    TICK,
    TICK_PERIOD_S,
)
from labrun_plugins.dynamixel.servos import DynamixelServos
from labrun_plugins.dynamixel.setting_up import shut_down
from labrun_plugins.dynamixel.settings import DynamixelSettings

_WINDOW_S = 5.0
"""The two clocks drift apart by less than a millisecond in this time."""


class TickClock:
    """Follows the clock of a servo, which counts milliseconds and starts anew every 32.768 s."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._least: deque[tuple[float, float]] = deque()
        """Offsets that may still become the least one: each is greater than those before it."""

    def at(self, tick_ms: int, received_s: float) -> tuple[float, float]:
        """Return the servo's own time of an answer, and how much later than the quickest ones it arrived.

        Parameters
        ----------
        tick_ms
            What the answer says.
        received_s
            When it arrived, by the host's clock.

        Returns
        -------
        device_s, late_s : float
            Time by the servo's clock, which goes on where the count starts anew, and the answer's lateness compared
            with the least delayed one of the last seconds.
        """
        device_s = 1e-3 * tick_ms
        if self._last is not None:
            last_device_s, last_received_s = self._last
            expected_s = last_device_s + received_s - last_received_s
            device_s += TICK_PERIOD_S * math.floor((expected_s - device_s) / TICK_PERIOD_S + 0.5)
        offset_s = received_s - device_s
        while self._least and self._least[0][0] < received_s - _WINDOW_S:
            self._least.popleft()
        while self._least and self._least[-1][1] >= offset_s:
            self._least.pop()
        self._least.append((received_s, offset_s))
        self._last = (device_s, received_s)
        return device_s, offset_s - self._least[0][1]


_FRESH_S = 0.03
_SILENCE_S = 0.5
_STALE_S = 0.05


class Measurement:
    """What the servos of one bus said last; any thread.

    Parameters
    ----------
    bus
        Open.
    ids
        Of all servos, in the file's order.
    clock
        Of the run.

    Attributes
    ----------
    device_s
        Id -> time by the servo's own clock at its last answer.
    """

    def __init__(self, bus: Bus, ids: list[int], clock: Clock) -> None:
        self._bus = bus
        self._ids = ids
        self._clock = clock
        self._ticks = {identity: TickClock() for identity in ids}
        self._counts: dict[int, int] = {}
        self._heard_s = dict.fromkeys(ids, clock.now() - 1.0)
        self._missed_s: dict[int, float] = {}
        self.device_s: dict[int, float] = {}

    def counts(self) -> Mapping[int, int]:
        """Return where every servo stands, id -> count, asked for unless it was asked a moment ago.

        Raises
        ------
        DeviceError
            A servo does not answer, or has shut down.
        """
        begin_s = self._clock.now()
        if min(self._heard_s.values()) > begin_s - _FRESH_S:
            return dict(self._counts)
        tried = 0
        while tried < TRIES or self._clock.now() - begin_s < _SILENCE_S:  # on a busy computer one is in time
            self.take()
            tried += 1
            if min(self._heard_s.values()) >= begin_s:
                return dict(self._counts)
        self._blame([identity for identity in self._ids if self._heard_s[identity] < begin_s])
        raise DeviceError(
            self._bus.device,
            f"answers of its servos come more than {1e3 * _STALE_S:.0f} ms late, or at times not at all",
            hint="set the adapter's latency timer to 1 ms, and close programs that keep this computer busy",
        )

    def take(self) -> tuple[float, dict[int, Status]] | None:
        """Ask all servos once.

        Returns
        -------
        tuple or None
            When the answers were there, and the answers (block `MOTION`); None if not all came in time.

        Raises
        ------
        DeviceError
            One has shut down, or has been silent for too long, or the port is gone.
        """
        return self._note(self._bus.group_read(self._ids, MOTION))

    def hear(self) -> tuple[float, dict[int, Status]] | None:
        """Take the answers to a question that somebody else asks; otherwise as `take`."""
        return self._note(self._bus.hear(self._ids, MOTION))

    def last(self) -> Mapping[int, int]:
        """Return where every servo stood when it was heard last, id -> count; nothing is asked."""
        return dict(self._counts)

    def _note(self, answers: Mapping[int, Status]) -> tuple[float, dict[int, Status]] | None:
        now = self._clock.now()
        fresh: dict[int, Status] = {}
        for identity, status in answers.items():
            if status.alert:
                raise shut_down(self._bus, identity)
            self.device_s[identity], late_s = self._ticks[identity].at(TICK.within(MOTION, status.data), now)
            if late_s < _STALE_S:
                fresh[identity] = status
                self._counts[identity] = PRESENT_POSITION.within(MOTION, status.data)
                self._heard_s[identity] = now
                self._missed_s.pop(identity, None)
        if len(fresh) == len(self._ids):
            return now, fresh
        missed = {i: self._missed_s.setdefault(i, now) for i in self._ids if i not in fresh}
        self._blame([identity for identity, since_s in missed.items() if now - since_s > _SILENCE_S])
        return None

    def _blame(self, missing: list[int]) -> None:
        """Ask servos one by one, and raise what is wrong with the first that does not answer."""
        for identity in missing:
            self._bus.read_bytes(identity, MOTION)


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

        Raises
        ------
        DeviceError
            Not streaming, a servo fell silent or has shut down, or the port is gone.
        """
        self._listener.check()
        if not self._listener.running:
            raise DeviceError(self.name, "is not streaming", hint="start() comes before read()")
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
        """Whether a loop has the bus."""
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
