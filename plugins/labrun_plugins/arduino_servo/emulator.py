"""RC servos on an emulated board: the firmware `labservo` from the wire, and shafts that turn the bench's joints."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices import Trajectory
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.arduino_servo.settings import KIND, PULSE_US, ArduinoServoSettings, Joint, channels_of
from labrun_plugins.labline.board import EmulatedBoard, LineMachine, RefusalError, Word, whole
from labrun_plugins.simulated.arduino_servo import PulsedShaft

FIRMWARE = "1.0"
MAX_RATE = "0500"
TICK_MS = 20
SLEW_US_PER_MS = 10
_NEUTRAL_US = 1500


class Channel:
    """One output: the pulse width it has, the one it goes to, and its limits once it is attached."""

    def __init__(self) -> None:
        self.pulse_us = self.target_us = _NEUTRAL_US
        self.limits_us: tuple[int, int] | None = None


class ServoBoardEmulator(EmulatedBoard):
    """A board with labservo. What its pulses move is the subclass's: it overrides `pulsed` and `released`.

    Faults besides those of `EmulatedBoard`: ``overcurrent`` (outputs off, ``EV,HW,OVERCURRENT``; what moves is refused
    until the board restarts).

    Parameters
    ----------
    channels
        How many it drives.
    switches
        Returns which of its switches are closed; without, it has none.
    """

    def __init__(
        self,
        name: str,
        context: EmulatorContext,
        *,
        kind: str,
        channels: int,
        switches: Callable[[], Sequence[bool]] = tuple,
    ) -> None:
        super().__init__(name, context)
        self._channels = [Channel() for _ in range(channels)]
        self._updated_ms = 0
        self.machine = LineMachine(
            kind, FIRMWARE, channels, MAX_RATE,
            {
                "ATT": Word(self._attach, (3, 3), moves=True),
                "SV": Word(self._set, (channels, channels), moves=True),
                "DET": Word(self._detach, (1, 1)),
                "ST": Word(self._status),
                "SW": Word(lambda _args, _now_s: [str(int(closed)) for closed in switches()]),
            },
            moving=self._moving, make_safe=self._make_safe, note=self.note,
        )  # fmt: skip

    def advance(self, now_s: float) -> float:
        """Bring pulses nearer to their targets, as fast as the slew limit allows."""
        if self.context.faults.take("overcurrent"):
            self._switch_off(now_s)
            self.machine.hardware_fault = "OVERCURRENT"
            self.send(self.machine.event("HW", "OVERCURRENT"))
            self.note("stop", how="overcurrent")
        if not self._moving():
            return math.inf
        now_ms = self.machine.millis(now_s)
        if now_ms - self._updated_ms >= TICK_MS:
            self._update(now_ms, now_s)
        left_ms = self._updated_ms + TICK_MS - now_ms
        return now_s + left_ms / 1000.0 if self._moving() else math.inf

    def reset(self, now_s: float) -> None:
        """Turn all outputs off."""
        self._switch_off(now_s)
        for channel in self._channels:
            channel.pulse_us = channel.target_us = _NEUTRAL_US

    def pulsed(self, channel: int, pulse_us: int, now_s: float) -> None:
        """Take note that a channel's output has another pulse width from now on."""

    def released(self, channel: int, now_s: float) -> None:
        """Take note that a channel gives no pulses any more."""

    def _attach(self, args: Sequence[str], now_s: float) -> Sequence[str]:
        number = self._number(args[0])
        low_us, high_us = (whole(arg, "1") for arg in args[1:])
        if not PULSE_US[0] <= low_us < high_us <= PULSE_US[1]:
            raise RefusalError("RANGE", "1")
        channel = self._channels[number]
        channel.target_us = min(max(channel.target_us, low_us), high_us)
        if channel.limits_us is None:
            channel.pulse_us = channel.target_us
        channel.limits_us = (low_us, high_us)
        self.note("attached", channel=number, limits_us=[low_us, high_us], pulse_us=channel.pulse_us)
        self.pulsed(number, self._channels[number].pulse_us, now_s)
        return ()

    def _set(self, args: Sequence[str], now_s: float) -> Sequence[str]:
        wanted = [whole(arg, str(number)) for number, arg in enumerate(args)]
        for number, (channel, pulse_us) in enumerate(zip(self._channels, wanted, strict=True)):
            low_us, high_us = channel.limits_us or PULSE_US
            if pulse_us != -1 and not low_us <= pulse_us <= high_us:
                raise RefusalError("RANGE", str(number))
        now_ms = self.machine.millis(now_s)
        if not self._moving():
            self._updated_ms = now_ms - TICK_MS  # at rest the first set-point starts the tick
        for channel, pulse_us in zip(self._channels, wanted, strict=True):
            if pulse_us != -1:
                channel.target_us = pulse_us
                if channel.limits_us is None:
                    channel.pulse_us = pulse_us
        self.note("command", pulses_us=wanted, watchdog_ms=self.machine.watchdog_ms)
        self._update(now_ms, now_s)
        return ()

    def _detach(self, args: Sequence[str], now_s: float) -> Sequence[str]:
        number = self._number(args[0])
        self._release(number, now_s)
        self.note("detached", channel=number)
        return ()

    def _status(self, _args: Sequence[str], now_s: float) -> Sequence[str]:
        if self.machine.hardware_fault:
            state = 3
        elif self.machine.tripped:
            state = 2
        else:
            state = int(self._moving())
        pulses = [str(channel.pulse_us) for channel in self._channels]
        return (str(state), *pulses, str(self.machine.millis(now_s)))

    def _moving(self) -> bool:
        return any(
            channel.limits_us is not None and channel.pulse_us != channel.target_us
            for channel in self._channels
        )

    def _make_safe(self, how: str, _now_s: float) -> None:
        """Hold every output where it is on its way."""
        for channel in self._channels:
            channel.target_us = channel.pulse_us
        self.note("stop", how=how, pulses_us=[channel.pulse_us for channel in self._channels])

    def _number(self, text: str) -> int:
        number = whole(text, "0")
        if not 0 <= number < len(self._channels):
            raise RefusalError("RANGE", "0")
        return number

    def _update(self, now_ms: int, now_s: float) -> None:
        most_us = SLEW_US_PER_MS * min(now_ms - self._updated_ms, TICK_MS)
        self._updated_ms = now_ms
        for number, channel in enumerate(self._channels):
            step_us = channel.target_us - channel.pulse_us
            if channel.limits_us is not None and step_us != 0:
                channel.pulse_us += min(max(step_us, -most_us), most_us)
                self.pulsed(number, self._channels[number].pulse_us, now_s)

    def _release(self, number: int, now_s: float) -> None:
        attached = self._channels[number].limits_us is not None
        self._channels[number].limits_us = None
        if attached:
            self.released(number, now_s)

    def _switch_off(self, now_s: float) -> None:
        for number in range(len(self._channels)):
            self._release(number, now_s)


class ArduinoServoEmulator(ServoBoardEmulator):
    """A board with labservo, and a servo on every channel that a joint of the settings names.

    Faults: those of `ServoBoardEmulator` (``overcurrent``), of `EmulatedBoard` (``watchdog``, ``restart``, ``error``,
    ``wrong-id``, ``stale``) and of the wire.
    """

    def __init__(self, name: str, settings: ArduinoServoSettings, context: EmulatorContext) -> None:
        super().__init__(name, context, kind=KIND, channels=len(settings.pins))
        tables = settings.joints or {_only_joint(name, context): Joint()}
        self._servos = {
            channel: (tables[joint], PulsedShaft(joint))
            for joint, channel in channels_of(tables, settings.pins).items()
        }

    def open(self) -> Mapping[str, Any]:
        """Plug it in; return how it is reached."""
        # the first call compiles, and the wire must not wait for that
        PulsedShaft("warm-up").command(0.1, 0.0)
        return super().open()

    def pulsed(self, channel: int, pulse_us: int, now_s: float) -> None:
        """Let the servo of a channel follow its pulse."""
        if channel not in self._servos:
            return
        table, shaft = self._servos[channel]
        motion = shaft.command(float(np.radians(table.servo_deg(pulse_us))), now_s)
        if motion is not None:
            self._turn(shaft.joint, motion, now_s)

    def released(self, channel: int, now_s: float) -> None:
        """Let a servo without pulses stay where it is."""
        if channel in self._servos:
            _, shaft = self._servos[channel]
            self._turn(shaft.joint, shaft.hold(now_s), now_s)

    def _turn(self, joint: str, motion: Trajectory, now_s: float) -> None:
        scene = self.context.scene
        if scene is not None and joint in scene.joints:
            self.bench.do(lambda: scene.drive(joint, motion, now_s))


def _only_joint(name: str, context: EmulatorContext) -> str:
    """Return the joint of a table that names none: the device's name, or the bench's only joint."""
    joints = () if context.scene is None else tuple(context.scene.joints)
    return joints[0] if name not in joints and len(joints) == 1 else name
