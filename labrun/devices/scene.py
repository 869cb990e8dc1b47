"""The simulated bench that the stand-in devices of a dry run look at and act on."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from labrun.arrays import FloatArray
from labrun.devices.trajectory import Trajectory


class Scene(Protocol):
    """A simulated bench. Its time is the clock's; it moves on when it is observed.

    A scene on which mountings differ also has ``mount(number)``: called after each `arrange` with the number of the
    mounting, where something is set by hand. The same number is the same mounting. One on which something happens by
    itself during a trial has ``begin(start_s)``: called with the clock's time at which the recording begins.

    One in front of which a person would read something off has ``answer(what)``: called after a trial, it returns the
    number or the word that the person would type.
    """

    signals: Mapping[str, str]
    """What can be felt or seen: signal name -> SI unit, for example ``{"force_x": "N"}``."""

    joints: tuple[str, ...]
    """What can be driven."""

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put in place what a person would change by hand between trials (a specimen, a mass)."""
        ...

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:
        """Command one joint (a trajectory of that joint alone) from the clock's `start_s` on."""
        ...

    def tow(
        self, from_m: float, to_m: float, speed_m_s: float, start_s: float, acceleration_m_s2: float = ...
    ) -> None:
        """Move the carriage along its line at constant speed from `start_s` on.

        A scene with ramps takes `acceleration_m_s2`, and has a value of its own for moves that do not say.
        """
        ...

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """Return the true signals at these times, shape (n, signals), advancing the physics as needed.

        Times ascend, and lie at most a few seconds before the latest time observed by anyone.
        """
        ...

    def snapshot(self) -> dict[str, Any]:
        """Return the whole memory of the bench as JSON-ready values, so that a resumed run goes on identically."""
        ...

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave."""
        ...

    def truth(self) -> dict[str, Any]:
        """Return parameters and hidden effects as JSON-ready values: stored sealed, never shown by a diagnosis."""
        ...
