"""What stand-ins and scenes give to a dry run whose steps are compiled: addresses and numbers.

All functions are of the signature ``(t, x, u, p, force, out)`` of `labrun.models.native`, whose arguments but `t` point
to float64. A *truth row* holds the scene's signals and, behind them, the angles of its joints (rad).
"""

from dataclasses import dataclass
from typing import Protocol

from labrun.arrays import FloatArray
from labrun.devices.samples import Samples


@dataclass(frozen=True, slots=True)
class CompiledScene:
    """A simulated bench from one point of its time grid on.

    Attributes
    ----------
    advance
        Address: moves `state` (x) on by one step to the time `t`, while the joints go straight from ``u[:joints]`` to
        ``u[joints:]`` (rad), with `parameters` (p); writes the signals at `t` to `out`.
    state, parameters
        Of the bench; `state` is changed in place.
    first
        Number of the grid point that is known last; its time is that times the scene's step.
    row
        Signals there.
    """

    advance: int
    state: FloatArray
    parameters: FloatArray
    first: int
    row: FloatArray


@dataclass(frozen=True, slots=True)
class CompiledSensor:
    """What a sensor makes of the truth.

    Attributes
    ----------
    measure
        Address: writes its first `channels` channels, made at `t`, to `out`; ``x`` are the signals and joints it
        feels, in their order, ``u`` standard normal numbers, `draws` a sample, ``p`` its parameters.
    parameters
        Of the sensor.
    signals, joints
        What it feels, by name.
    channels
        How many of its channels are written; the others are derived from them (see `CompiledStandIn.completed`).
    draws
        Random numbers of a sample.
    """

    measure: int
    parameters: FloatArray
    signals: tuple[str, ...]
    joints: tuple[str, ...]
    channels: int
    draws: int


@dataclass(frozen=True, slots=True)
class Ahead:
    """Samples that arrive up to a time, before their values are known: (n,) each, and random numbers (n, draws)."""

    taken_s: FloatArray
    device_time_s: FloatArray
    host_time_s: FloatArray
    draws: FloatArray
    lost: int


class CompiledStandIn(Protocol):
    """A simulated sensor that can take part in a compiled dry run."""

    def compiled(self) -> CompiledSensor | str:
        """Return its compiled form, or why there is none."""
        ...

    def ahead(self, until_s: float, draws: int) -> Ahead:
        """Return the samples that arrive up to a time."""
        ...

    def completed(self, values: FloatArray) -> FloatArray:
        """Return all channels, given those that were computed, shape (n, `CompiledSensor.channels`)."""
        ...

    def deliver(self, block: Samples) -> None:
        """Take what the next `read` returns."""
        ...


class CompiledJoints(Protocol):
    """A simulated actuator that can take part in a compiled dry run."""

    joints: tuple[str, ...]

    def compiled_joints(self, step_s: float) -> FloatArray:
        """Return a row for each joint.

        Two by two numbers that take error (goal - angle) and speed one step on (row by row), step of the command
        (rad), dead band (rad), greatest speed (rad/s), grid steps from command to command, sign.
        """
        ...

    def joint_state(self, joint: str, time_s: float) -> tuple[float, float]:
        """Return angle (rad) and speed (rad/s) of a shaft."""
        ...

    def moved(self, joint: str, time_s: FloatArray, angle_rad: FloatArray, goal_rad: FloatArray) -> None:
        """Take note of how a shaft moved, and of what it was told."""
        ...
