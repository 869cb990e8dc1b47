"""What drivers give to a compiled loop in real time: newest samples, and a function that sends a set-point."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from labrun.arrays import FloatArray
from labrun.compiled import Pointer, kernel, native
from labrun.devices.listening import Newest
from labrun.devices.protocols import Actuator, Sensor

__all__ = [
    "BEYOND",
    "BUSY",
    "FREE_S",
    "GONE",
    "HALT",
    "HALTED",
    "NOT_TAKEN",
    "SENT",
    "TOO_LATE",
    "CompiledWire",
    "HandingOver",
    "Pointer",
    "Showing",
    "kernel",
    "native",
]

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
        Address of a function of the signature of `labrun.compiled.native`: at the clock's `t` it sends the angles
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
