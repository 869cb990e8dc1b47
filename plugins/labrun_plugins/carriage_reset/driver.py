"""A servo and pulley as the runner's carriage: it winds a line up, and pays it out."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from labrun.devices import (
    DeviceContext,
    DeviceSettings,
    FloatArray,
    Identity,
    Pacing,
    Trajectory,
)
from labrun.errors import LimitExceededError
from labrun_plugins.arduino_servo.servo_board import BoardDevice, ServoBoard
from labrun_plugins.carriage_reset.settings import KIND, CarriageResetSettings

LINE = "line"
"""Stands where a servo's motion names its joint; the trajectory's values are lengths, m, in place of angles."""
_AT_START_M = 1e-3
_SLACK = 1e-9


def check_move(device: str, settings: CarriageResetSettings, to_m: float, speed_m_s: float) -> None:
    """Refuse a move that leaves a limit.

    Raises
    ------
    LimitExceededError
        Beyond the limits of the file, the line's ends, or what the winch can do.
    DeviceError
        Not numbers, or a speed that is not positive.
    """
    settings.limits.require_move(device, to_m, speed_m_s)
    low_m, high_m = settings.travel_m
    if not low_m - _SLACK <= to_m <= high_m + _SLACK:
        raise LimitExceededError(
            device, f"travel to {to_m:g} m leaves {low_m:g} ... {high_m:g} m; the move was not sent"
        )
    if speed_m_s > settings.top_speed_m_s * (1 + _SLACK):
        raise LimitExceededError(
            device,
            f"{speed_m_s:g} m/s is above the {settings.top_speed_m_s:g} m/s its winch can do; the move was not sent",
            hint="lower trial.carriage.return_speed_m_s, or measure the winch and set top_speed_m_s",
        )


def line_motion(settings: CarriageResetSettings, from_m: float, to_m: float, speed_m_s: float) -> Trajectory:
    """Return the line's motion from a length to another at constant speed.

    A move that ends at the start is a pull: with `release`, the carriage is held there for `hold_s`, and then the
    line is paid out as fast as it may.
    """
    low_m, high_m = settings.travel_m
    times_s, lines_m = [0.0], [from_m]

    def go(goal_m: float, speed: float) -> None:
        duration_s = abs(goal_m - lines_m[-1]) / speed
        if duration_s > 0.0:
            times_s.append(times_s[-1] + duration_s)
            lines_m.append(goal_m)

    go(to_m, speed_m_s)
    if settings.release and to_m <= low_m + _AT_START_M:
        times_s.append(times_s[-1] + settings.hold_s)
        lines_m.append(to_m)
        go(high_m, settings.speed_m_s)
    return Trajectory((LINE,), np.array(times_s), np.array(lines_m)[:, None])


class CarriageReset(BoardDevice):
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
    kind: ClassVar[str] = KIND

    def __init__(self, name: str, settings: CarriageResetSettings, context: DeviceContext) -> None:
        self.travel_m = settings.travel_m
        self._settings = settings
        self._clock = context.clock
        board = ServoBoard(
            name,
            settings,
            context.clock,
            kind=KIND,
            windows_us={settings.channel: settings.pulse_window_us()},
            rest_us={settings.channel: round(settings.exact_pulse_us(settings.travel_m[1]))},
            pulses_of=self._pulses,
        )
        super().__init__(name, settings, board)

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
