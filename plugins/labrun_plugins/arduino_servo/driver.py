"""RC servos on an Arduino: joints whose set-points go out at 50 Hz."""

from collections.abc import Mapping
from typing import ClassVar

from labrun.devices import DeviceContext, DeviceSettings, Identity, Pacing, Trajectory
from labrun_plugins.arduino_servo.servo_board import BoardDevice, ServoBoard
from labrun_plugins.arduino_servo.settings import KIND, ArduinoServoSettings, Joint, Pulses, channels_of


class ArduinoServo(BoardDevice):
    """RC servos behind the firmware `labservo`.

    A servo does not say where it is: `pose` is where the pulses sent last ask it to be. A channel gives no pulses
    before the first motion; with its first pulse a servo jumps to the beginning of that motion.
    """

    Settings: ClassVar[type[DeviceSettings]] = ArduinoServoSettings
    kind: ClassVar[str] = KIND

    def __init__(self, name: str, settings: ArduinoServoSettings, context: DeviceContext) -> None:
        self._tables = dict(settings.joints or {name: Joint()})
        self.joints = tuple(self._tables)
        self._settings = settings
        pulses = Pulses(name, self._tables, channels_of(self._tables, settings.pins), settings.limits)
        self._pulses = pulses
        board = ServoBoard(
            name,
            settings,
            context.clock,
            kind=KIND,
            windows_us=pulses.by_channel(pulses.windows_us),
            rest_us=pulses.by_channel(pulses.rest_us()),
            pulses_of=lambda angle_rad: pulses.by_channel(pulses.of(angle_rad)),
        )
        super().__init__(name, settings, board)

    def identify(self) -> Identity:
        """Say what answered, and what stands between angle and pulse."""
        hello = self._board.hello
        details = {
            "kind": hello.kind,
            "channels": str(hello.channels),
            "max_rate_hz": f"{hello.max_rate_hz:g}",
            "watchdog_ms": str(self._settings.watchdog_ms),
            "feedback": "none: angles are commanded ones",
        }
        for joint, table in self._tables.items():
            low_us, high_us = self._pulses.windows_us[joint]
            details[f"joint {joint}"] = (
                f"pin {self._settings.pins[self._pulses.channels[joint]]}, "
                f"pulse = 1500 us + {table.us_per_deg:g} us/deg * ({table.sign:+d} * angle + "
                f"{table.neutral_deg:g} deg), {low_us} ... {high_us} us"
            )
        return Identity("RC servos on Arduino", firmware=f"{hello.kind} {hello.firmware}", details=details)

    def pose(self) -> Mapping[str, float]:
        """Return the angles that the pulses sent last ask for, rad: an RC servo does not say where it is."""
        return self._pulses.angles_rad(self._board.sent_us())

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Start following at the clock's `start_s`, then hold the last point.

        Raises
        ------
        LimitExceededError
            The trajectory leaves a limit: nothing of it is sent.
        DeviceError
            Wrong joints, no answer, or the watchdog expired.
        """
        token = self._board.motion_token()
        self._pulses.check(trajectory)
        self._board.follow(trajectory, start_s, token)

    def restart_pacing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        self._board.restart_timing()

    def pacing(self) -> Pacing:
        """Return how evenly set-points have gone out since `restart_pacing`, or since it was opened."""
        return self._board.timing
