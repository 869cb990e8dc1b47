"""The straight line along which the tool is carried, the few lines of URScript that labrun sends, and one move."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from labrun.devices import DeviceError, FloatArray
from labrun.errors import LimitExceededError
from labrun_plugins.ur5.settings import SPEED_SHARE, Ur5Settings
from labrun_plugins.ur5.state import PAUSED, ArmState

Pose = tuple[float, float, float, float, float, float]
"""Tool pose in the base frame: x, y, z (m) and rotation vector (rad)."""


@dataclass(frozen=True)
class Line:
    """Positions along a line in the base frame, at one orientation.

    Attributes
    ----------
    origin_m : (3,)
        Position zero.
    direction : (3,)
        Unit vector of rising position.
    orientation_rad : (3,)
        Rotation vector that the tool keeps.
    """

    origin_m: FloatArray
    direction: FloatArray
    orientation_rad: FloatArray

    @classmethod
    def through(
        cls,
        pose: ArrayLike,
        direction: ArrayLike,
        origin_m: ArrayLike | None = None,
        orientation_rad: ArrayLike | None = None,
    ) -> "Line":
        """Return the line through `origin_m`, at `orientation_rad`; what is not given is taken from `pose`."""
        here = np.asarray(pose, dtype=float)
        along = np.asarray(direction, dtype=float)
        return cls(
            here[:3].copy() if origin_m is None else np.asarray(origin_m, dtype=float),
            along / np.linalg.norm(along),
            here[3:].copy() if orientation_rad is None else np.asarray(orientation_rad, dtype=float),
        )

    def position_m(self, pose: FloatArray) -> FloatArray:
        """Return how far along the line tool poses (..., 6) are."""
        return np.asarray((pose[..., :3] - self.origin_m) @ self.direction)

    def speed_m_s(self, twist: FloatArray) -> FloatArray:
        """Return the speed along the line of tool velocities (..., 6)."""
        return np.asarray(twist[..., :3] @ self.direction)

    def pose(self, position_m: float) -> Pose:
        """Return the tool pose at a position."""
        point = self.origin_m + position_m * self.direction
        x, y, z, rx, ry, rz = (float(value) for value in (*point, *self.orientation_rad))
        return x, y, z, rx, ry, rz

    def beside_m(self, pose: FloatArray) -> float:
        """Return the distance of a tool pose from the line."""
        away = pose[:3] - self.origin_m
        return float(np.linalg.norm(away - (away @ self.direction) * self.direction))

    def turned_rad(self, pose: FloatArray) -> float:
        """Return the angle between a tool pose's orientation and the line's."""
        cosine = abs(float(quaternion(pose[3:]) @ quaternion(self.orientation_rad)))
        return 2.0 * math.acos(min(1.0, cosine))


def quaternion(rotation_rad: FloatArray) -> FloatArray:
    """Return the unit quaternion (w, x, y, z) of a rotation vector."""
    angle = float(np.linalg.norm(rotation_rad))
    # sin(a/2)/a tends to 1/2, where the division would fail.
    share = 0.5 if angle < 1e-9 else math.sin(angle / 2.0) / angle
    return np.array([math.cos(angle / 2.0), *(share * np.asarray(rotation_rad, dtype=float))])


BRAKING_M_S2 = 2.0
STOP = f"stopl({BRAKING_M_S2:.1f})\n"
"""A program of one line: it takes the place of the one that runs, and brakes the tool along its path."""
STOP_PROGRAM = "stop program\n"
"""Understood at the primary port: ends the program."""


def move_program(
    target: Pose, *, speed_m_s: float, acceleration_m_s2: float, register: str, watchdog_s: float
) -> str:
    """Return the program of one straight move at constant speed, which ends when the computer falls silent.

    Parameters
    ----------
    target
        Tool pose at the end.
    speed_m_s, acceleration_m_s2
        Of the speed's trapezoid.
    register
        Input that has to be refreshed.
    watchdog_s
        Longest time between two refreshments.

    Raises
    ------
    ValueError
        A number that is not finite, or a name that is no register.
    """
    if not register.isidentifier():
        raise ValueError(f"{register!r} is not an input register")
    pose = ", ".join(_number(value) for value in target)
    return (
        "def labrun_move():\n"
        f'  rtde_set_watchdog("{register}", {_number(1.0 / watchdog_s)}, "stop")\n'
        f"  movel(p[{pose}], a={_number(acceleration_m_s2)}, v={_number(speed_m_s)})\n"
        "end\n"
    )


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise ValueError(f"{value} in a program for the arm")
    return f"{value:.9f}"  # never with an exponent


ARRIVED_M = 1e-3
_BEGIN_S = 1.5
"""There is no acknowledgement of a program: one that has not begun by then will not."""
_REPLACED_S = 0.5
"""For this long after the order, a program that ends is the one from before."""
_REDUCED_S = 0.2
"""Speed scaling may dip for a cycle or two; this long is somebody's slider."""
FULL = 1e-3
"""Speed scaling and slider count as full this close to 1."""

Phase = Literal["sent", "running", "arrived", "ended", "not begun", "paused"]


@dataclass
class Move:
    """A move that was ordered, followed package by package.

    Attributes
    ----------
    from_m, to_m, speed_m_s
        As ordered.
    sent_s
        Host time of the order.
    phase
        How far it is; ``ended`` short of its goal, ``not begun`` and ``paused`` are failures.
    stopped_m
        Where it ended.
    samples, constant
        How many packages tell of the move, and how many of those of its constant-speed part.
    scaling
        Reduced speed scaling that lasted; 1 if there was none.
    """

    from_m: float
    to_m: float
    speed_m_s: float
    sent_s: float
    phase: Phase = "sent"
    stopped_m: float = 0.0
    samples: int = 0
    constant: int = 0
    scaling: float = 1.0
    _reduced_since_s: float | None = None

    def at_speed(self, state: ArmState) -> bool:
        """Tell whether a package is of the constant-speed part: target speed within 0.5 %, nothing scaled."""
        speed = float(np.linalg.norm(state.target_twist[:3]))
        return (
            abs(speed - self.speed_m_s) <= SPEED_SHARE * self.speed_m_s
            and abs(state.speed_scaling - 1.0) < FULL
            and abs(state.slider - 1.0) < FULL
        )

    def follow(self, state: ArmState, position_m: float) -> bool:
        """Take a package into account; return whether it is of the constant-speed part."""
        if self.phase not in ("sent", "running"):
            return False
        since_s = state.host_s - self.sent_s
        if state.runtime in PAUSED:
            self._end("paused", position_m)
            return False
        if not state.program_runs:
            near = abs(position_m - self.to_m) <= ARRIVED_M
            if self.phase == "running" and since_s > _REPLACED_S:
                self._end("arrived" if near else "ended", position_m)
            elif since_s > _BEGIN_S:
                self._end("arrived" if near else "not begun", position_m)
            elif near:
                self._end("arrived", position_m)
            return False
        self.phase = "running"
        self._watch_scaling(state)
        constant = self.at_speed(state)
        self.samples += 1
        self.constant += constant
        return constant

    def _watch_scaling(self, state: ArmState) -> None:
        if state.speed_scaling > 1.0 - FULL:
            self._reduced_since_s = None
        elif self._reduced_since_s is None:
            self._reduced_since_s = state.host_s
        elif state.host_s - self._reduced_since_s > _REDUCED_S:
            self.scaling = min(self.scaling, state.speed_scaling)

    def _end(self, phase: Phase, position_m: float) -> None:
        self.phase = phase
        self.stopped_m = position_m


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
    settings.limits.require_move(device, to_m, speed_m_s)
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
            f"moves at {100 * move.scaling:.0f} % of the commanded speed (speed scaling)",
            hint=_SLIDER_HINT,
        )
    return None
