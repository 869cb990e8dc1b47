"""The driver's end of a board with `labservo`: set-points at a steady rate, watchdog, stop; what labrun doctor asks."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from labrun.devices import (
    Clock,
    CommandStream,
    DeviceError,
    FloatArray,
    Health,
    Identity,
    Pacing,
    Remark,
    Trajectory,
    opened,
)
from labrun_plugins.arduino_servo.settings import BoardSettings
from labrun_plugins.labline.handshake import probe, stop_from_scratch
from labrun_plugins.labline.session import Hello, LineSession, StoppedError

RESTING, MOVING, WATCHDOG, FAULT = range(4)
"""States: at its set-points, on its way to them, stopped by the watchdog, outputs off because of the hardware."""
_COMPLAINTS = {
    WATCHDOG: "its watchdog has expired: it stopped by itself",
    FAULT: "it turned its outputs off: over-current or supply",
}


@dataclass(frozen=True, slots=True)
class Status:
    """State, pulse width of each channel (us), and the board's milliseconds since its start."""

    state: int
    pulses_us: tuple[int, ...]
    millis: int

    @classmethod
    def parse(cls, device: str, fields: tuple[str, ...], channels: int) -> Self:
        """Return what the fields behind ``OK,ST`` say; DeviceError if they are not as they should be."""
        try:
            state, *pulses_us, millis = (int(field) for field in fields)
            if len(pulses_us) != channels:
                raise ValueError(f"{len(pulses_us)} pulse widths")
        except ValueError as error:
            raise DeviceError(
                device,
                f"its status says {','.join(fields)!r}; state, {channels} pulse widths and a time were expected",
                hint="flash the firmware that stands in the plugin's folder",
            ) from error
        return cls(state, tuple(pulses_us), millis)

    @property
    def complaints(self) -> tuple[str, ...]:
        """What is wrong; empty if nothing is."""
        if self.state in {RESTING, MOVING}:
            return ()
        return (_COMPLAINTS.get(self.state, f"it is in a state {self.state} that this driver does not know"),)


MOST_CHANNELS = 12
"""So many set-points fit on a line."""
LEAVE = -1
"""In place of a pulse width: this channel stays as it is."""
_REST_WATCHDOG_MS = 1000
"""Watchdog while servos stand still: a computer that is busy storing a trial stops nothing by being late."""
_SETTLED_S = 0.5
"""So long after its last point a motion counts as ended."""


class ServoBoard:
    """One board, its servos, and the thread that sends their set-points.

    Parameters
    ----------
    kind
        What its firmware must say it is.
    windows_us
        Channel -> least and greatest pulse width, us: the firmware is told, and refuses others by itself.
    rest_us
        Channel -> pulse width that is assumed before any was sent.
    pulses_of
        Returns the pulse width of each channel for one point of a trajectory; raises DeviceError for a point that must
        not be sent.
    """

    def __init__(
        self,
        device: str,
        settings: BoardSettings,
        clock: Clock,
        *,
        kind: str,
        windows_us: Mapping[int, tuple[int, int]],
        rest_us: Mapping[int, int],
        pulses_of: Callable[[FloatArray], Mapping[int, int]],
    ) -> None:
        self.session = LineSession(device, settings.port, clock, boot_wait_s=settings.boot_wait_s)
        self._device = device
        self._settings = settings
        self._clock = clock
        self._kind = kind
        self._windows_us = dict(windows_us)
        self._rest_us = dict(rest_us)
        self._pulses_of = pulses_of
        self._stream = self._new_stream()
        self._hello: Hello | None = None
        self._attached = False
        self._arming = threading.Lock()
        self._token = 0
        self._ends_s = 0.0
        self._sent_us: Mapping[int, int] = self._rest_us
        self._stopped = False

    @property
    def hello(self) -> Hello:
        """What the board said first; DeviceError if it is not open."""
        return opened(self._device, self._hello)

    @property
    def channels_needed(self) -> int:
        """How many channels the firmware must drive."""
        return max(self._windows_us) + 1

    @property
    def timing(self) -> Pacing:
        """How evenly set-points have gone out since `restart_timing`."""
        return self._stream.timing

    def restart_timing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        self._stream.restart_timing()

    def open(self) -> None:
        """Connect; no servo gets a pulse yet.

        Raises DeviceError: as of `LineSession.open`; too few channels; or a watchdog that cannot be armed.
        """
        self.close()
        hello = self.session.open(self._kind)
        if hello.channels < self.channels_needed:
            self.session.close()
            raise DeviceError(
                self._device,
                f"its firmware drives {hello.channels} channels, {self.channels_needed} are required",
                hint="flash labservo with all pins in its table PINS, and give the same pins here",
            )
        if hello.channels > MOST_CHANNELS:
            self.session.close()
            raise DeviceError(
                self._device,
                f"its firmware says it drives {hello.channels} channels; {MOST_CHANNELS} fit on a line",
                hint="flash labservo with fewer pins in its table PINS",
            )
        self._make_ready()
        self._hello = hello
        self._attached = self._stopped = False
        self._sent_us = self._rest_us
        self._stream = self._new_stream()
        self._stream.start()

    def health(self) -> Health:
        """Ask the board for its state; notes lines that were damaged or stayed unanswered."""
        if self._hello is None:
            return Health(ok=False, notes=("not connected",))
        self.check()
        status = self._status()
        notes = list(status.complaints)
        if self.session.counts.rejected:
            notes.append(f"{self.session.counts.rejected} damaged lines since it was opened")
        if self.session.unanswered:
            notes.append(f"{self.session.unanswered} set-points stayed unanswered since it was opened")
        return Health(ok=not status.complaints, notes=tuple(notes))

    def sent_us(self) -> Mapping[int, int]:
        """Return the pulse width of each channel as it was sent last, us; after a stop, as the board has it."""
        self.hello  # noqa: B018 -- raises if it is not open
        self.check()
        # it stopped on its way to the last set-point: the board knows where
        if self._stopped and self._attached:
            pulses_us = self._status().pulses_us
            self._sent_us = {channel: pulses_us[channel] for channel in self._windows_us}
            self._stopped = False
        return self._sent_us

    def motion_token(self) -> int:
        """Return what `follow` is called with, taken at the beginning of a command; a later stop makes it void."""
        return self.session.motion_token()

    def follow(self, trajectory: Trajectory, start_s: float, token: int) -> None:
        """Send a motion that was checked, from the clock's `start_s` on; then hold its last point.

        Raises DeviceError: no answer, the watchdog expired, or the first point must not be sent.
        """
        self.hello  # noqa: B018 -- raises if it is not open
        self.check()
        try:
            with self._arming:
                self._ends_s = max(start_s, self._clock.now()) + trajectory.duration_s + _SETTLED_S
                if self.session.watchdog_ms != self._settings.watchdog_ms:
                    self.session.arm(self._settings.watchdog_ms)
                if not self._attached:
                    self._attach(trajectory.angle_rad[0], token)
        except StoppedError:
            return
        self._token = token
        self._stopped = False
        self._stream.follow(trajectory, start_s)

    def send(self, point: FloatArray) -> None:
        """Send one point of a trajectory, if its pulses may be sent; called by the stream's thread."""
        pulses_us = self._pulses_of(point)
        if self.session.post("SV", *self._line(pulses_us), token=self._token):
            self._sent_us = pulses_us

    def safe_stop(self) -> None:
        """Have the board stop where it is, asking once more if it does not answer; no set-point follows."""
        if not self.session.is_open:
            return
        self._stream.halt()  # first: while the stop's answer is awaited, a new motion may be asked for already
        self.session.stop()
        self._stopped = True

    def check(self) -> None:
        """Raise what either thread met."""
        self.session.check()
        self._stream.check()

    def close(self) -> None:
        """Stop, turn the watchdog off so that it has nothing to tell, and disconnect. The servos go on holding."""
        if self._hello is not None:
            self._hello = None
            self._stream.end()
            self._part()
        self.session.close()

    def _make_ready(self) -> None:
        """End what an earlier program may have left: a motion, or a watchdog that has expired."""
        try:
            self.session.stop()
            self.session.arm(self._settings.watchdog_ms)
            self.session.arm(0)
        except DeviceError:
            self.session.close()
            raise

    def _new_stream(self) -> CommandStream:
        return CommandStream(
            self._clock, self._settings.rate_hz, self.send,
            idle=self._idle, idle_every_s=self._settings.watchdog_ms / 4000.0,
        )  # fmt: skip

    def _status(self) -> Status:
        return Status.parse(self._device, self.session.request("ST"), self.hello.channels)

    def _attach(self, first: FloatArray, token: int) -> None:
        """Turn the pulses on, beginning with those of the first set-point."""
        first_us = self._pulses_of(first)
        # The pulses wait on the board until the channels are attached: no servo sees any other.
        self.session.request("SV", *self._line(first_us), token=token)
        for channel, window_us in self._windows_us.items():
            self.session.request("ATT", channel, *window_us, token=token)
        self._sent_us = first_us
        self._attached = True

    def _line(self, pulses_us: Mapping[int, int]) -> list[int]:
        """Return the arguments of ``SV``: channels that are not used are left as they are."""
        row = [LEAVE] * self.hello.channels
        for channel, pulse_us in pulses_us.items():
            row[channel] = pulse_us
        return row

    def _idle(self) -> None:
        """Feed the watchdog, and give it more time once a motion has ended; called by the stream's thread."""
        if not self.session.watchdog_ms:
            return
        self.session.feed()
        rest_ms = max(_REST_WATCHDOG_MS, self._settings.watchdog_ms)
        if self.session.watchdog_ms < rest_ms and self._clock.now() > self._ends_s:
            with self._arming:
                if self._clock.now() > self._ends_s:
                    self.session.arm(rest_ms)

    def _part(self) -> None:
        try:
            self.session.check()
            if self.session.stop() and self.session.watchdog_ms:
                self.session.arm(0)
        except DeviceError:
            return  # it is being closed because it does not answer


_MAJOR = "1"
_FLASH = "flash firmware/labservo/labservo.ino of the plugin's folder"


def examine(name: str, board: ServoBoard, settings: BoardSettings) -> list[Remark]:
    """Return remarks on firmware, channels, rate and watchdog."""
    hello, session = board.hello, board.session
    remarks = [
        _firmware(name, hello),
        _channels(name, hello, board.channels_needed),
        _rate(name, hello, settings.rate_hz),
    ]
    if session.watchdog_ms == 0:  # nothing has moved yet: it can be tried
        remarks.append(_watchdog(name, session, settings.watchdog_ms))
    if session.counts.rejected:
        text = (
            f"{session.counts.rejected} of {session.counts.rejected + session.counts.accepted} lines damaged"
        )
        advice = "use a shorter or shielded USB cable, away from the servos' supply; connect the grounds"
        remarks.append(Remark("warning", name, text, advice))
    return remarks


def _firmware(name: str, hello: Hello) -> Remark:
    text = f"firmware {hello.kind} {hello.firmware}"
    if hello.firmware.split(".")[0] != _MAJOR:
        return Remark("problem", name, f"{text}; this driver knows {_MAJOR}.x", _FLASH)
    return Remark("ok", name, text)


def _channels(name: str, hello: Hello, needed: int) -> Remark:
    text = f"{hello.channels} channels, {needed} needed"
    return Remark.judged(
        hello.channels >= needed, name, text, f"add the pins to PINS and {_FLASH}", "problem"
    )


def _rate(name: str, hello: Hello, rate_hz: float) -> Remark:
    text = f"takes {hello.max_rate_hz:g} set-points/s, {rate_hz:g} are sent"
    advice = f"set rate_hz = {hello.max_rate_hz:g}"
    return Remark.judged(hello.max_rate_hz >= rate_hz, name, text, advice, "problem")


def _watchdog(name: str, session: LineSession, watchdog_ms: int) -> Remark:
    try:
        session.arm(watchdog_ms)
        session.arm(0)
    except DeviceError as error:
        return Remark("problem", name, f"its watchdog cannot be armed: {str(error).splitlines()[0]}", _FLASH)
    return Remark("ok", name, f"watchdog takes {watchdog_ms} ms")


class BoardDevice:
    """Servos behind a board; what they move is for the subclass to say."""

    kind: ClassVar[str]
    """What its firmware says it is."""

    def __init__(self, name: str, settings: BoardSettings, board: ServoBoard) -> None:
        self.name = name
        self._board = board
        self._board_settings = settings

    def open(self) -> None:
        """Connect; no servo gets a pulse yet.

        Raises DeviceError: no port, no answer, other firmware, or fewer channels than are needed.
        """
        self._board.open()

    def health(self) -> Health:
        """Ask the board for its state; notes lines that were damaged or stayed unanswered."""
        return self._board.health()

    def safe_stop(self) -> None:
        """Have the board stop where it is, asking once more if it does not answer; no set-point follows."""
        self._board.safe_stop()

    def close(self) -> None:
        """Stop, turn the watchdog off so that it has nothing to tell, and disconnect. Servos go on holding."""
        self._board.close()

    def examine(self) -> list[Remark]:
        """Look at firmware, channels, rate and watchdog, for `labrun doctor --hardware`."""
        return examine(self.name, self._board, self._board_settings)

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Connect from scratch and stop; raises DeviceError if the board does not answer."""
        stop_from_scratch(name, settings.port)

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Tell whether a board with this firmware is at a port; takes up to 3.5 s, as boards restart when opened."""
        return probe(port, cls.kind)
