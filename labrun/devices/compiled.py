"""What devices give to a compiled loop: drivers to one in real time, stand-ins and scenes to one in a dry run.

All functions are of the signature ``(t, x, u, p, force, out)`` of `labrun.models.native`, whose arguments but `t` point
to float64. A *truth row* holds the scene's signals and, behind them, the angles of its joints (rad).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from labrun.arrays import FloatArray
from labrun.compiled import Pointer, kernel, native
from labrun.devices.listening import Newest
from labrun.devices.protocols import Actuator, Sensor
from labrun.devices.samples import Samples

__all__ = [
    "BEYOND", "BUSY", "FREE_S", "GONE", "HALT", "HALTED", "NOT_TAKEN", "SENT", "TOO_LATE", "Ahead",
    "CompiledJoints", "CompiledScene", "CompiledSensor", "CompiledStandIn", "CompiledWire", "HandingOver",
    "Pointer", "Showing", "kernel", "native",
]  # fmt: skip

SENT, NOT_TAKEN, HALTED, BEYOND, TOO_LATE, GONE = range(6)
"""What sending a set-point comes to: it is on the wire; the port took it not, the next one may be; a stop has come;
it leaves a limit; the device heard nothing for longer than its watchdog waits; the port is gone."""
HALT, BUSY, FREE_S = range(3)
"""Places of `CompiledWire.state`: not 0 forbids to send; not 0 while a set-point is being sent; from when on the wire
has room for the next one (the clock's time)."""


@dataclass(frozen=True, slots=True)
class CompiledWire:
    """How compiled code sends set-points.

    Attributes
    ----------
    send
        Address of a function of the signature of `labrun.compiled.functions`: at the clock's `t` it sends the angles
        ``u`` (rad), which it checks once more against the limits, and writes what it came to to ``out[0]``; ``x`` is
        `state`, ``p`` are `parameters`. It does not wait.
    state
        Its memory; its first numbers are `HALT`, `BUSY` and `FREE_S`.
    parameters
        Of the device.
    """

    send: int
    state: FloatArray
    parameters: FloatArray


@runtime_checkable
class Showing(Sensor, Protocol):
    """A sensor that shows each sample as it comes."""

    def show(self, newest: Newest | None) -> None:
        """Put every sample there, too, from now on; None ends it. Comes after `start`."""
        ...


@runtime_checkable
class HandingOver(Actuator, Protocol):
    """An actuator that lets a compiled loop send its set-points."""

    def prepare(self) -> None:
        """Have compiled what takes seconds the first time; may come before `open`."""
        ...

    def hand_over(self, joints: Sequence[str], angles_rad: FloatArray, rate_hz: float) -> CompiledWire:
        """Let a loop of `rate_hz` send from now on, joints in this order, beginning where they are: `angles_rad`.

        Until `take_back` the driver sends nothing of its own but stops.

        Raises
        ------
        DeviceError, LimitExceededError
            As of `follow`.
        """
        ...

    def take_back(self) -> None:
        """Send its own again; harmless if nothing was handed over."""
        ...


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
