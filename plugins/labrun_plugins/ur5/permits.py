"""What has to hold before a program is sent, and what went wrong with one that was."""

import math

from labrun.devices import DeviceError
from labrun.errors import LimitExceededError
from labrun_plugins.ur5.line import Line
from labrun_plugins.ur5.motion import FULL, Move
from labrun_plugins.ur5.settings import Ur5Settings
from labrun_plugins.ur5.state import ArmState

_TURNED_RAD = math.radians(3.0)
_SLIDER_HINT = (
    'set the speed slider at the bottom of the pendant to 100 % and leave reduced mode; on_reduced_speed = "note" goes '
    "on all the same, at another speed than the file's"
)
_FAILURES = {
    "not begun": (
        "did not begin the move that was sent",
        "is it in Remote Control, without a pop-up on the pendant? Then labrun resume",
    ),
    "paused": (
        "its program is paused at {here:.4g} m",
        "stop the program on the pendant, then labrun resume",
    ),
    "ended": (
        "its program ended at {here:.4g} m, before {goal:.4g} m",
        "it was stopped on the pendant, replaced by another program, or missed this computer for more than "
        "{watchdog:g} ms (watchdog_ms); find out which, then labrun resume",
    ),
}


def check_order(
    device: str, settings: Ur5Settings, travel_m: tuple[float, float], to_m: float, speed_m_s: float
) -> None:
    """Check a move against the limits; DeviceError or LimitExceededError: it must not be sent."""
    if not (math.isfinite(to_m) and math.isfinite(speed_m_s) and speed_m_s > 0):
        raise DeviceError(
            device,
            f"cannot travel to {to_m:g} m at {speed_m_s:g} m/s; the speed is above zero",
            hint="change trial.carriage",
        )
    for excess in settings.limits.travel_excess(to_m, speed_m_s):
        raise LimitExceededError(
            device, f"{excess}; the move was not sent", hint="change trial.carriage, or the device's limits"
        )
    low, high = travel_m
    if not low <= to_m <= high:
        raise LimitExceededError(
            device,
            f"travel to {to_m:g} m leaves {low:g} ... {high:g} m; the move was not sent",
            hint="set limits.travel_m of the device to what the bench allows",
        )


def check_place(device: str, settings: Ur5Settings, line: Line, state: ArmState) -> None:
    """Check that the tool is on the line: a move from beside it would not follow it."""
    beside_m = line.beside_m(state.pose)
    if not beside_m <= settings.off_line_m:
        raise DeviceError(
            device,
            f"its tool stands {1000 * beside_m:.1f} mm beside the line ({1000 * settings.off_line_m:g} mm are "
            "allowed); the move was not sent",
            hint="jog the tool onto the line with the pendant, or correct origin_m and direction",
        )
    turned_rad = line.turned_rad(state.pose)
    if not turned_rad <= _TURNED_RAD:
        raise DeviceError(
            device,
            f"its tool is turned by {math.degrees(turned_rad):.1f} deg against the line's orientation; the move was "
            "not sent",
            hint="turn the tool with the pendant, or correct orientation_rad",
        )


def check_speed(device: str, settings: Ur5Settings, state: ArmState) -> None:
    """Check that the controller will drive at the speed that it is told."""
    if settings.on_reduced_speed == "fault" and state.slider < 1.0 - FULL:
        raise DeviceError(
            device,
            f"its speed slider stands at {100 * state.slider:.0f} %; the move was not sent",
            hint=_SLIDER_HINT,
        )


def failure_of(device: str, settings: Ur5Settings, move: Move | None, complaint: str) -> DeviceError | None:
    """Return why a move failed; None if it did not, or none was ordered."""
    if move is None:
        return None
    if complaint and move.phase != "arrived":
        return DeviceError(
            device,
            f"its controller complains about the move: {complaint}",
            hint="the pendant's log says more; is the whole line within reach, and away from singular poses?",
        )
    if move.phase in _FAILURES:
        message, hint = _FAILURES[move.phase]
        words = {"here": move.stopped_m, "goal": move.to_m, "watchdog": settings.watchdog_ms}
        return DeviceError(device, message.format(**words), hint=hint.format(**words))
    if move.scaling < 1.0 and settings.on_reduced_speed == "fault":
        return DeviceError(
            device,
            f"moves at {100 * move.scaling:.0f} % of the speed asked for (speed scaling)",
            hint=_SLIDER_HINT,
        )
    return None
