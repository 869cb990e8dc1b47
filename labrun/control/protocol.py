"""What a reference, a feedback and a controller are; nothing to inherit."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from labrun.control.history import History
from labrun.spec import Value

Condition = Mapping[str, Value]
FindFile = Callable[[str], Path]
"""Where a file named in an experiment is; raises SpecError if there is none."""


class Reference(Protocol):
    """What a loop's feedback should be, over time; known beforehand."""

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial, in the unit of the feedback."""
        ...


class ReferencePlugin(Protocol):
    """The class an entry point of group ``labrun.references`` names.

    It may have `Settings` (a pydantic model of its keys), `expression_settings` (keys that hold an expression as such,
    checked when the file is read), `names` (names it gives to those), and the static method ``embed(settings, find)``,
    which returns the settings with the content of the files they name, so that a stored experiment needs no other.
    """

    def __call__(self, settings: Mapping[str, Any], condition: Condition) -> Reference:
        """Make the reference of one trial; raises SpecError on keys that do not hold."""
        ...


class Feedback(Protocol):
    """What a loop compares with its reference: a number from the samples so far.

    Attributes
    ----------
    channels
        The channels it needs, ``device.channel``.
    unit
        Of its value.
    """

    channels: tuple[str, ...]
    unit: str

    def memory_s(self, period_s: float | None) -> float:
        """Return how far back it looks, s; the gait's cycle takes `period_s`."""
        ...

    def __call__(self, history: History, period_s: float | None) -> float:
        """Return the number now; every channel has at least one sample."""
        ...


class FeedbackPlugin(Protocol):
    """The class an entry point of group ``labrun.feedbacks`` names.

    It may have `Settings`, `channel_settings` (its keys that name channels), and `needs_cycle(settings)`, which tells
    whether only a gait that repeats will do.
    """

    def __call__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> Feedback:
        """Make the feedback, given the unit of every channel; raises SpecError on keys that do not hold."""
        ...


@dataclass(frozen=True, slots=True)
class Step:
    """What a controller sees at one step of its loop.

    Attributes
    ----------
    time_s
        Time of the trial.
    dt_s
        Since the step before; one period at the first.
    reference, feedback
        In the feedback's unit.
    drive
        Where the variable it sets stands now.
    reference_at
        The reference at any time of the trial: it is known beforehand.
    """

    time_s: float
    dt_s: float
    reference: float
    feedback: float
    drive: float
    reference_at: Callable[[float], float]

    @property
    def error(self) -> float:
        """Reference less feedback."""
        return self.reference - self.feedback


@dataclass(frozen=True, slots=True)
class LoopContext:
    """What a controller may know of its loop before it begins.

    Attributes
    ----------
    period_s
        Time from step to step.
    low, high
        Bounds of the variable it sets.
    start
        Its value before the first step.
    """

    period_s: float
    low: float
    high: float
    start: float


class Controller(Protocol):
    """Sets a variable of the gait, step by step. Made anew for every trial, with nothing left of the one before."""

    def update(self, step: Step) -> float:
        """Return the value it wants the variable to have."""
        ...

    def applied(self, drive: float) -> None:
        """Be told the value that the variable is given, after range and slew, so that no integral winds up."""
        ...


class ControllerPlugin(Protocol):
    """The class an entry point of group ``labrun.controllers`` names; it may have `Settings` and `embed`."""

    def __call__(self, settings: Mapping[str, Any], context: LoopContext) -> Controller:
        """Make the controller of one trial; raises SpecError on keys that do not hold."""
        ...
