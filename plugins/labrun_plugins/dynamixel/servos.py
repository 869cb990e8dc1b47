"""A bus of Dynamixel servos: joints that follow trajectories, and tell where they are when asked."""

import math
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from labrun.devices import (
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    FloatArray,
    Health,
    Identity,
    Trajectory,
    opened,
)
from labrun.devices.pacing import CommandStream, Pacing
from labrun.devices.protocols import Remark
from labrun_plugins.dynamixel import setting_up
from labrun_plugins.dynamixel.bus import TRIES, Bus
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.commands import (
    STOP_WAIT_S,
    CommandCheck,
    check_watchdogs,
    goals_here,
    hold,
    switch_off,
    switch_on,
)
from labrun_plugins.dynamixel.control_table import (
    BUS_WATCHDOG,
    GOAL_POSITION,
    MOTION,
    PRESENT_POSITION,
    TICK,
    TICK_PERIOD_S,
    TORQUE_ENABLE,
    WATCHDOG_FIRMWARE,
    Scale,
)
from labrun_plugins.dynamixel.setting_up import Servo, find_servos, set_up, shut_down
from labrun_plugins.dynamixel.settings import WATCHDOG_STEP_MS, DynamixelSettings

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

        Raises DeviceError: a servo does not answer, or has shut down.
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


_NEVER = -1
_IDLE_S = 0.03
_QUIET_S = 0.015
"""A bus on which nothing was sent for so long gets a question, to keep the watchdogs quiet."""


class DynamixelServos:
    """A bus of X-series servos in position or extended position mode."""

    Settings: ClassVar[type[DeviceSettings]] = DynamixelSettings

    def __init__(self, name: str, settings: DynamixelSettings, context: DeviceContext) -> None:
        self.name = name
        self.joints = tuple(settings.joints)
        self._settings = settings
        self._clock = context.clock
        self._ids = [table.id for table in settings.joints.values()]
        self._scales = {table.id: Scale.of(table, settings) for table in settings.joints.values()}
        self._check = CommandCheck(name, settings, tuple(self._scales.values()))
        names = {table.id: joint for joint, table in settings.joints.items()}
        self._bus = Bus(name, settings.port, settings.baud, context.clock, names)
        self._servos: list[Servo] = []
        self._stream = self._new_stream()
        self._gate = threading.Lock()
        """Held from the look at `_halted` to the last byte of a set-point: none follows a stop."""
        self._stops = 0
        self._granted = _NEVER
        """What `_stops` was when the present motion was asked for: any stop since then has ended it."""
        self._energised = False
        self._measurement = Measurement(self._bus, self._ids, self._clock)

    def open(self) -> None:
        """Connect, find every servo and set it up; torque stays as it was, so that joints may be turned by hand.

        Raises DeviceError: the port, a servo or its set-up is not what the file says.
        """
        self.close()
        self._bus.open()
        try:
            self._servos = find_servos(self._bus, self._settings)
            for servo in self._servos:
                set_up(self._bus, servo, self._scales[servo.id], self._settings, self._clock)
        except BaseException:
            self._bus.close()
            raise
        self._measurement = Measurement(self._bus, self._ids, self._clock)
        self._granted, self._energised = _NEVER, False
        self._stream = self._new_stream()

    def identify(self) -> Identity:
        """Say which servos these are, and what analysis needs of their set-up."""
        self._require_open()
        return setting_up.identity(self._servos, self._settings)

    def examine(self) -> list[Remark]:
        """Look at what a bench relies on: set-up, firmware, supply, time a measurement takes."""
        from labrun_plugins.dynamixel.setting_up import remarks

        self._require_open()
        return remarks(self._bus, self._servos, self._settings, self._clock)

    def health(self) -> Health:
        """Ask every servo for temperature, voltage, errors, torque and watchdog.

        Raises DeviceError: one does not answer, or the command stream has failed.
        """
        self._require_open()
        self._check_threads()
        return setting_up.health(self._bus, self._servos, energised=self._energised)

    def pose(self) -> Mapping[str, float]:
        """Return the measured angles, rad.

        Raises DeviceError: a servo does not answer, has shut down, or the command stream has failed.
        """
        self._require_open()
        self._check_threads()
        counts = self._measurement.counts()
        return {
            joint: self._scales[identity].angle_rad(counts[identity])
            for joint, identity in zip(self.joints, self._ids, strict=True)
        }

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following at the clock's `start_s`, then hold the last point; switches the torque on if it is off.

        Raises
        ------
        LimitExceededError
            The trajectory leaves a limit: nothing of it is sent.
        DeviceError
            Wrong joints, beyond the reach of the operating mode, or no answer.
        """
        self._require_open()
        self._check_threads()
        stops = self._stops
        motion = self._check.trajectory(trajectory, self.joints)
        if self._halted:
            self._check_beginning(motion, start_s)
        try:
            if not self._energised:
                self._energise()
        except DeviceError:
            if self._stops == stops:
                raise
        with self._gate:
            if self._stops == stops:
                self._check.forget()
                self._granted = stops
                self._stream.follow(motion, start_s)
        if self._stops != stops:
            # A stop by another thread came in between, and has the last word: the torque may have come after it.
            self.safe_stop()

    def restart_pacing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        self._stream.restart_timing()

    def pacing(self) -> Pacing:
        """Return how evenly set-points have gone out since `restart_pacing`, or since it was opened."""
        return self._stream.timing

    def safe_stop(self) -> None:
        """Hold where the joints are, or switch the torque off, as `on_stop` says; never raises."""
        self._stops += 1
        self._stream.halt()
        held = self._gate.acquire(timeout=STOP_WAIT_S)
        try:
            self._stop_servos()
        except Exception:  # noqa: S110  a port that is gone takes no stop: the servos' own watchdog stops them
            pass
        finally:
            if held:
                self._gate.release()

    def close(self) -> None:
        """Disconnect: with ``hold`` a joint keeps its place and its torque, else the torque goes off."""
        self._granted = _NEVER
        self._stream.end()
        try:
            if self._bus.is_open and self._energised:
                if self._settings.on_stop == "torque-off":
                    self._bus.group_write(TORQUE_ENABLE, dict.fromkeys(self._ids, 0))
                self._bus.group_write(BUS_WATCHDOG, dict.fromkeys(self._guarded(), 0))
        except DeviceError:
            pass  # it is gone, and its watchdog has stopped it
        self._energised = False
        self._bus.close()

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Connect from scratch and stop: the runner is dead or hangs."""
        from labrun.devices.clock import RealClock
        from labrun_plugins.dynamixel.commands import emergency_stop

        emergency_stop(name, settings, RealClock())

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Tell whether Dynamixels answer at a port, at 1 Mbit/s or at the factory's 57 600 bits/s."""
        from labrun.devices.clock import RealClock
        from labrun_plugins.dynamixel.setting_up import probe

        return probe(port, RealClock())

    @property
    def _halted(self) -> bool:
        return self._granted != self._stops

    def _new_stream(self) -> CommandStream:
        return CommandStream(
            self._clock,
            self._settings.command_hz,
            self._send,
            idle=self._idle,
            idle_every_s=min(_IDLE_S, 1e-3 * self._settings.watchdog_ms / 3.0),
        )

    def _check_beginning(self, motion: Trajectory, start_s: float) -> None:
        """Refuse a motion that begins elsewhere than where the joints have come to rest."""
        begun_s = min(max(self._clock.now() - start_s, 0.0), motion.duration_s)
        counts = self._measurement.counts()
        here_rad = np.array([self._scales[identity].angle_rad(counts[identity]) for identity in self._ids])
        self._check.beginning(self.joints, motion.at(begun_s)[0], here_rad)

    def _send(self, angles_rad: FloatArray) -> None:
        """Send one set-point, unless it leaves a limit or a stop has come."""
        now = self._clock.now()
        angles = self._check.set_point(angles_rad, now)
        self._check_watchdogs()
        goals = {i: self._scales[i].count(float(angle)) for i, angle in zip(self._ids, angles, strict=True)}
        with self._gate:
            self._bus.group_write(GOAL_POSITION, goals, wanted=lambda: not self._halted)

    def _idle(self) -> None:
        """Keep the watchdogs quiet while nothing is commanded, with a look at where the joints are."""
        if self._energised:
            self._check_watchdogs()
            if self._clock.now() - self._bus.sent_s > _QUIET_S:
                self._measurement.take()

    def _check_watchdogs(self) -> None:
        """After a pause, whichever thread has ended it, ask for tripped watchdogs: goals get no answer."""
        gap_s = self._bus.take_gap_s()
        if gap_s > 1e-3 * self._settings.watchdog_ms:
            check_watchdogs(self._bus, self._guarded(), gap_s)

    def _energise(self) -> None:
        """Switch the torque on where the joints are."""
        goals = goals_here(self._bus, self._scales, self._measurement.counts())
        self._energised = True  # already now: a stop in the midst of it must find the torque on
        self._bus.take_gap_s()  # pauses before the watchdogs are armed do not count
        try:
            switch_on(self._bus, goals, self._guarded(), self._settings.watchdog_ms // WATCHDOG_STEP_MS)
        except BaseException:
            self._energised = False
            raise

    def _guarded(self) -> list[int]:
        return [servo.id for servo in self._servos if servo.firmware >= WATCHDOG_FIRMWARE]

    def _stop_servos(self) -> None:
        if not self._bus.is_open:
            return
        if self._settings.on_stop == "torque-off":
            self._energised = False
            switch_off(self._bus, self._ids)
        elif self._energised:
            hold(self._bus, self._scales, self._last_set_point())

    def _last_set_point(self) -> FloatArray | None:
        """Return the angles sent last, rad, in the order of `joints`; None before any."""
        return self._stream.set_point()

    def _check_threads(self) -> None:
        self._stream.check()

    def _require_open(self) -> None:
        opened(self.name, self._bus.is_open)
