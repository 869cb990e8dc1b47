"""How the arm is, as one data package tells it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from labrun.devices import FloatArray

REQUIRED = (
    "timestamp", "actual_TCP_pose", "actual_TCP_speed", "target_TCP_speed", "speed_scaling",
    "runtime_state", "robot_mode", "safety_mode", "robot_status_bits",
)  # fmt: skip
OPTIONAL = ("target_speed_fraction", "safety_status_bits", "actual_TCP_force")
"""Left out where the controller's software does not have them."""

RUNNING = 7
ROBOT_MODES = {
    -1: "no controller", 0: "disconnected", 1: "confirm safety", 2: "booting", 3: "power off", 4: "power on",
    5: "idle", 6: "backdrive", 7: "running", 8: "updating firmware",
}  # fmt: skip
SAFETY_MODES = {
    1: "normal", 2: "reduced", 3: "protective stop", 4: "recovery", 5: "safeguard stop", 6: "system emergency stop",
    7: "robot emergency stop", 8: "violation", 9: "fault", 10: "validate joint id", 11: "undefined",
}  # fmt: skip
PLAYING = 2
PAUSED = (3, 4)
_PROGRAM_BIT = 1 << 1
_PROTECTIVE, _SAFEGUARD, _EMERGENCY, _BROKEN, _STOPPED = 1 << 2, 1 << 4, 0b111 << 5, 0b11 << 8, 1 << 10


@dataclass(frozen=True, slots=True)
class ArmState:
    """One data package; `host_s` is when it arrived."""

    time_s: float
    host_s: float
    pose: FloatArray
    actual_twist: FloatArray
    target_twist: FloatArray
    speed_scaling: float
    slider: float
    runtime: int
    robot_mode: int
    safety_mode: int
    status_bits: int
    safety_bits: int
    force: FloatArray | None

    @classmethod
    def of(cls, values: Mapping[str, Any], host_s: float) -> "ArmState":
        """Return the state that a data package tells."""
        force = values.get("actual_TCP_force")
        return cls(
            values["timestamp"],
            host_s,
            np.array(values["actual_TCP_pose"]),
            np.array(values["actual_TCP_speed"]),
            np.array(values["target_TCP_speed"]),
            values["speed_scaling"],
            values.get("target_speed_fraction", 1.0),
            values["runtime_state"],
            values["robot_mode"],
            values["safety_mode"],
            values["robot_status_bits"],
            values.get("safety_status_bits", 0),
            None if force is None else np.array(force),
        )

    @property
    def program_runs(self) -> bool:
        """Tell whether the controller executes a program."""
        return self.runtime == PLAYING or bool(self.status_bits & _PROGRAM_BIT)


class Trouble(NamedTuple):
    """Why the arm does not move, and what a person can do about it."""

    message: str
    hint: str


_PROTECTIVE_STOP = Trouble(
    "is in a protective stop: it met a force, a joint limit or a singularity",
    "look at the bench and take away the cause; then, at least 5 s after the stop, close the pop-up and unlock the arm "
    "on the pendant (labrun never unlocks it), and labrun resume",
)
_EMERGENCY_STOP = Trouble(
    "is in an emergency stop",
    "make the bench safe, turn the red button to release it, power on and release the brakes on the pendant, then "
    "labrun resume",
)
_SAFEGUARD_STOP = Trouble(
    "is in a safeguard stop: a door, light curtain or other safety input holds it",
    "close the guard and reset it, then labrun resume",
)
_POWER = (
    "power on and release the brakes on the pendant (bottom left corner), until it says Normal or Running"
)


def trouble_of(state: ArmState) -> Trouble | None:
    """Return why the arm cannot move; None if it can. Any safety mode but normal and reduced is a stop."""
    bits, mode = state.safety_bits, state.safety_mode
    if mode == 3 or bits & _PROTECTIVE:
        return _PROTECTIVE_STOP
    if mode in (6, 7) or bits & _EMERGENCY:
        return _EMERGENCY_STOP
    if mode == 5 or bits & _SAFEGUARD:
        return _SAFEGUARD_STOP
    if mode not in (1, 2) or bits & (_BROKEN | _STOPPED):
        name = SAFETY_MODES.get(mode, f"mode {mode}")
        return Trouble(
            f"is stopped by its safety system ({name})",
            "the pendant says why; clear it there, then labrun resume",
        )
    if state.robot_mode != RUNNING:
        name = ROBOT_MODES.get(state.robot_mode, f"mode {state.robot_mode}")
        return Trouble(f"is not running but in mode {name!r}", _POWER)
    return None
