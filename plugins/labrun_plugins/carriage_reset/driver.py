"""A servo and pulley as the runner's carriage: it winds a line up, and pays it out."""

from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.devices import DeviceContext, DeviceSettings, FloatArray, Health, Identity, Pacing, Remark
from labrun.errors import LimitExceededError
from labrun_plugins.arduino_servo.examination import examine
from labrun_plugins.arduino_servo.servo_board import ServoBoard
from labrun_plugins.carriage_reset.line_motion import check_move, line_motion
from labrun_plugins.carriage_reset.settings import KIND, CarriageResetSettings
from labrun_plugins.labline.handshake import probe, stop_from_scratch


class CarriageReset:
    """A winch that pulls a free-swimming carriage back to its start: a `Carriage` for the runner.

    Its position is the length of its line as last commanded, 0 at the carriage's start: the carriage is somewhere
    between the start and there. Where exactly only a tracker knows. Before the first move the line counts as paid
    out; the first move begins by paying it out, which pulls at nothing.

    Parameters
    ----------
    name, settings, context
        As for every device.
    """

    Settings: ClassVar[type[DeviceSettings]] = CarriageResetSettings

    def __init__(self, name: str, settings: CarriageResetSettings, context: DeviceContext) -> None:
        self.name = name
        self.travel_m = settings.travel_m
        self._settings = settings
        self._clock = context.clock
        self._board = ServoBoard(
            name,
            settings,
            context.clock,
            kind=KIND,
            windows_us={settings.channel: settings.pulse_window_us()},
            rest_us={settings.channel: round(settings.exact_pulse_us(settings.travel_m[1]))},
            pulses_of=self._pulses,
        )

    def open(self) -> None:
        """Connect; the servo gets no pulse yet.

        Raises
        ------
        DeviceError
            No port, no answer, or other firmware.
        """
        self._board.open()

    def identify(self) -> Identity:
        """Say what answered, and what stands between length and pulse."""
        hello = self._board.hello
        settings = self._settings
        return Identity(
            "servo and pulley on Arduino",
            firmware=f"{hello.kind} {hello.firmware}",
            details={
                "kind": hello.kind,
                "watchdog_ms": str(settings.watchdog_ms),
                "line": f"0 m at {settings.start_us} us, {settings.stroke_m:g} m at {settings.end_us} us",
                "release": f"after {settings.hold_s:g} s" if settings.release else "no",
                "feedback": "none: positions are commanded lengths of line",
            },
        )

    def health(self) -> Health:
        """Ask the board for its state; notes lines that were damaged or stayed unanswered."""
        return self._board.health()

    def position_m(self) -> float:
        """Return the length of line as last commanded, m: the carriage is no farther from its start than this."""
        return self._settings.line_m(self._board.sent_us()[self._settings.channel])

    def travel(self, to_m: float, speed_m_s: float) -> None:
        """Wind the line up or pay it out to a length at constant speed; returns at once.

        After a move to the start the carriage is held for `hold_s`, and the line is paid out again (`release`).

        Raises
        ------
        LimitExceededError
            Beyond travel or speed: the move is not sent.
        DeviceError
            A speed that is not positive, no answer, or the watchdog expired.
        """
        token = self._board.motion_token()
        check_move(self.name, self._settings, to_m, speed_m_s)
        motion = line_motion(self._settings, self.position_m(), to_m, speed_m_s)
        self._board.follow(motion, self._clock.now(), token)

    def restart_pacing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        self._board.restart_timing()

    def pacing(self) -> Pacing:
        """Return how evenly set-points have gone out since `restart_pacing`, or since it was opened."""
        return self._board.timing

    def safe_stop(self) -> None:
        """Have the board stop the winch where it is, asking once more if it does not answer; nothing follows."""
        self._board.safe_stop()

    def close(self) -> None:
        """Stop, turn the watchdog off so that it has nothing to tell, and disconnect. The winch goes on holding."""
        self._board.close()

    def examine(self) -> list[Remark]:
        """Look at firmware, channels, rate and watchdog, for `labrun doctor --hardware`."""
        return examine(self.name, self._board, self._settings)

    @classmethod
    def emergency_stop(cls, name: str, settings: Any) -> None:
        """Connect from scratch and stop; raises DeviceError if the board does not answer."""
        stop_from_scratch(name, settings.port)

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Tell whether a board with this firmware is at a port; takes up to 3.5 s, as boards restart when opened."""
        return probe(port, KIND)

    def _pulses(self, line_m: FloatArray) -> Mapping[int, int]:
        """Return the pulse width of one set-point; LimitExceededError if it must not be sent."""
        exact_us = self._settings.exact_pulse_us(float(line_m[0]))
        low_us, high_us = self._settings.pulse_window_us()
        if not low_us - 0.5 <= exact_us <= high_us + 0.5:
            raise LimitExceededError(
                self.name,
                f"a set-point of {line_m[0]:.4g} m asks for a pulse of {exact_us:.0f} us, outside of "
                f"{low_us} to {high_us} us; it was not sent",
                hint="set limits.travel_m, so that the plan is refused before anything moves",
            )
        return {self._settings.channel: min(max(round(exact_us), low_us), high_us)}
