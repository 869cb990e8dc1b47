"""One loop during one trial: what it reads, what it wants, what it gets."""

from collections.abc import Sequence
from dataclasses import dataclass

from labrun.control.history import History
from labrun.control.making import controller_of, make_controller, make_reference
from labrun.control.protocol import Condition, Feedback, LoopContext, Step
from labrun.errors import ExperimentError
from labrun.spec import LoopTable


@dataclass(frozen=True, slots=True)
class LoopRecord:
    """One step of a loop, as it is stored: in the order of `labrun.spec.LOOP_CHANNELS`."""

    reference: float
    feedback: float
    error: float
    drive: float
    requested: float


class Loop:
    """A loop of an experiment, begun anew for one trial.

    Parameters
    ----------
    name, table
        As in the file.
    feedback
        What it reads.
    condition
        Of the trial: which controller is in charge, and values of its gains.
    period_s
        Time from step to step.
    cycle_s
        Of the gait; None if it does not repeat.
    """

    def __init__(
        self,
        name: str,
        table: LoopTable,
        feedback: Feedback,
        condition: Condition,
        period_s: float,
        cycle_s: float | None,
    ) -> None:
        self.name = name
        self.variable = table.drives
        self.start = table.start
        self._feedback = feedback
        self._cycle_s = cycle_s
        self._low, self._high = (float(bound) for bound in table.range)
        self._most = None if table.slew_per_s is None else table.slew_per_s * period_s
        self._reference = make_reference(name, table.reference, condition)
        controller = controller_of(name, table, condition)
        context = LoopContext(period_s, self._low, self._high, self.start)
        self._controller = make_controller(
            name, controller, table.controllers[controller], condition, context
        )

    @property
    def channels(self) -> Sequence[str]:
        """The channels it reads."""
        return self._feedback.channels

    def step(self, time_s: float, dt_s: float, drive: float, history: History) -> LoopRecord:
        """Take one step.

        Parameters
        ----------
        time_s, dt_s
            Time of the trial, and since the step before.
        drive
            Where the variable stands now.
        history
            The samples so far.

        Returns
        -------
        LoopRecord
            With the value that the variable is to reach one period from now: within range, and within the slew rate of
            where it stands.

        Raises
        ------
        ExperimentError
            The controller asks for something that is no finite number.
        """
        reference = self._reference(time_s)
        feedback = self._feedback(history, self._cycle_s)
        step = Step(time_s, dt_s, reference, feedback, drive, self._reference)
        requested = float(self._controller.update(step))
        if not -float("inf") < requested < float("inf"):
            raise ExperimentError(
                f"loop {self.name}: its controller asks for {self.variable} = {requested} at {time_s:.3f} s",
                hint="look at its gains, and at the feedback recorded so far",
            )
        applied = min(max(requested, self._low), self._high)
        if self._most is not None:
            applied = min(max(applied, drive - self._most), drive + self._most)
        self._controller.applied(applied)
        return LoopRecord(reference, feedback, step.error, applied, requested)
