"""One loop during one trial: feedback, reference, output."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.control.history import History
from labrun.control.making import controller_of, make_controllers, make_references
from labrun.control.protocol import Condition, Feedback, LoopContext, Numbers, VectorStep
from labrun.errors import ExperimentError
from labrun.experiment import LoopTable


@dataclass(frozen=True, slots=True)
class LoopRecord:
    """One step of a loop, as it is stored: in the order of `LoopShape.channels`, a number for each part."""

    reference: Numbers
    feedback: Numbers
    error: Numbers
    drive: Numbers
    requested: Numbers
    more: Numbers = ()

    @property
    def row(self) -> Numbers:
        """All numbers in one row."""
        return (*self.reference, *self.feedback, *self.error, *self.drive, *self.requested, *self.more)


class Loop:
    """A loop of an experiment, begun anew for one trial.

    Parameters
    ----------
    condition
        Of the trial: which controller is in charge, and values of its gains.
    cycle_s
        Of the gait; None if it does not repeat.
    """

    def __init__(
        self,
        name: str,
        table: LoopTable,
        feedbacks: Sequence[Feedback],
        condition: Condition,
        context: LoopContext,
        cycle_s: float | None,
    ) -> None:
        self.name = name
        self.variables = tuple(table.drives)
        self.feedbacks = tuple(feedbacks)
        self._cycle_s = cycle_s
        self._low, self._high = context.low, context.high
        self._most = math.inf if table.slew_per_s is None else table.slew_per_s * context.period_s
        self.reference: Callable[[float], Numbers] = make_references(
            name, table.references, condition, len(context.components)
        )
        self.in_charge = controller_of(name, table, condition)
        """Name of its controller."""
        self.controller = make_controllers(
            name, self.in_charge, table.controllers[self.in_charge], condition, context
        )
        self._more = tuple(table.shape.more)
        self.channels = tuple(channel for feedback in self.feedbacks for channel in feedback.channels)
        """The channels that its feedback is made of."""
        self._seen = tuple(getattr(self.controller, "channels", ()))

    def begin(self) -> None:
        """Start what the controller runs in parallel."""
        getattr(self.controller, "begin", lambda: None)()

    def ready(self) -> bool:
        """Tell whether the controller is ready."""
        return bool(getattr(self.controller, "ready", lambda: True)())

    def end(self) -> None:
        """End it."""
        getattr(self.controller, "end", lambda: None)()

    def remarks(self) -> list[str]:
        """Return remarks on this trial."""
        return [f"loop {self.name}: {text}" for text in getattr(self.controller, "remarks", list)()]

    def step(self, time_s: float, dt_s: float, drives: Mapping[str, float], history: History) -> LoopRecord:
        """Take one step.

        Parameters
        ----------
        time_s, dt_s
            Time of the trial, and since the step before.
        drives
            Where the variables stand now.

        Returns
        -------
        LoopRecord
            With the values that the variables are to reach one period from now: within range, and within the slew rate
            of where they stand.

        Raises
        ------
        ExperimentError
            The controller asks for something that is no finite number.
        """
        reference = self.reference(time_s)
        feedback = _flat([table(history, self._cycle_s) for table in self.feedbacks])
        here = tuple([drives[name] for name in self.variables])
        seen = {channel: history.newest(channel) for channel in self._seen}
        step = VectorStep(
            time_s,
            dt_s,
            reference,
            feedback,
            here,
            self.reference,
            history.newest_s(self.channels),
            {channel: value for channel, (_, value) in seen.items()},
            {channel: at_s for channel, (at_s, _) in seen.items()},
        )
        with np.errstate(all="ignore"):  # what is no finite number is told below, with its name
            requested = self.controller.update(step)
        for variable, value in zip(self.variables, requested, strict=True):
            if not math.isfinite(value):
                raise ExperimentError(
                    f"loop {self.name}: controller {self.in_charge} asks for {variable} = {value} at {time_s:.3f} s",
                    hint="look at its gains or weights, and at the feedback recorded so far",
                )
        low, high, most = self._low, self._high, self._most
        applied = tuple(
            [
                min(max(min(max(wanted, low), high), now - most), now + most)
                for wanted, now in zip(requested, here, strict=True)
            ]
        )
        self.controller.applied(applied)
        error = tuple([a - b for a, b in zip(reference, feedback, strict=True)])
        return LoopRecord(reference, feedback, error, applied, requested, self._recorded())

    def _recorded(self) -> Numbers:
        if not self._more:
            return ()
        values: Mapping[str, float] = getattr(self.controller, "recorded", dict)()
        return tuple([values.get(name, math.nan) for name in self._more])


def _flat(values: Sequence[float | Numbers]) -> Numbers:
    """Return the numbers of all feedbacks in one row."""
    if len(values) == 1 and isinstance(values[0], tuple):
        return values[0]
    return tuple([float(value) for value in values if not isinstance(value, tuple)])
