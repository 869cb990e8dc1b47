"""What a reference, a feedback and a controller are; nothing to inherit.

Each is of one number, or of several: then its class says ``several = True``, and numbers come as tuples.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from labrun.control.history import History
from labrun.experiment import Value

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
    checked when the file is read), `several` (its value is a tuple of numbers), `names` (names it gives to those), and
    the static method ``embed(settings, find)``, which returns the settings with the content of the files they name, so
    that a stored experiment needs no other.
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
    whether only a gait that repeats will do. One whose value is a tuple of numbers has ``components(settings)``: their
    names.
    """

    def __call__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> Feedback:
        """Make the feedback, given the unit of every channel; raises SpecError on keys that do not hold."""
        ...


@dataclass(frozen=True, slots=True)
class Step:
    """Input of a controller at one step of its loop.

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


Numbers = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class VectorStep:
    """Input of a controller with several components; as `Step`, with tuples.

    Attributes
    ----------
    feedback_s
        When the newest sample of the feedback was made, time of the trial.
    channels
        Newest sample of each channel that the controller asked for.
    channels_s
        When each of them was made, time of the trial.
    """

    time_s: float
    dt_s: float
    reference: Numbers
    feedback: Numbers
    drives: Numbers
    reference_at: Callable[[float], Numbers]
    feedback_s: float
    channels: Mapping[str, float]
    channels_s: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class LoopContext:
    """What a controller may know of its loop before it begins.

    Attributes
    ----------
    period_s
        Time from step to step.
    low, high
        Bounds of each variable it sets.
    start
        Their value before the first step.
    components, unit
        Names of the feedback's numbers (one without a name, if it is a single number), and their unit.
    drives
        Variables it sets -> unit.
    rig
        What the bench is called: the scene of the experiment file; empty if it names none.
    simulated
        Whether time is simulated: then nothing may depend on how long it takes to compute.
    """

    period_s: float
    low: float
    high: float
    start: float
    components: tuple[str, ...] = ("",)
    unit: str = ""
    drives: Mapping[str, str] = field(default_factory=dict)
    rig: str = ""
    simulated: bool = True


class Controller(Protocol):
    """Sets a variable of the gait at every step; created anew for every trial."""

    def update(self, step: Step) -> float:
        """Return the value it wants the variable to have."""
        ...

    def applied(self, drive: float) -> None:
        """Receive the value after clipping to range and slew rate, for anti-windup."""
        ...


class VectorController(Protocol):
    """Sets all variables of its loop, step by step. Its class says ``several = True``.

    Besides, it may have `channels`, the channels whose newest samples it wants with every step; ``begin()``, called as
    the trial is about to be recorded, ``ready()``, asked again and again until it is True, and ``end()``, called after
    the recording whatever happened; ``recorded()``, its values of the channels that its class announces with
    ``records(settings)``; and ``remarks()``, what to tell the person of this trial.
    """

    def update(self, step: VectorStep) -> Numbers:
        """Return the values it wants the variables to have."""
        ...

    def applied(self, drives: Numbers) -> None:
        """Receive the values after clipping to range and slew rate."""
        ...


class ControllerPlugin(Protocol):
    """The class an entry point of group ``labrun.controllers`` names.

    It may have `Settings`, `embed`, `channel_settings` (its keys that name channels), `several`, and
    ``records(settings)``: channels that it adds to those of its loop, name -> unit.
    """

    def __call__(self, settings: Mapping[str, Any], context: LoopContext) -> Controller | VectorController:
        """Make the controller of one trial; raises SpecError on keys that do not hold."""
        ...
