"""The best so far, told to whoever watches the run."""

from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self

from labrun.search.leaders import condition_key

if TYPE_CHECKING:
    from labrun.runner.progress import Progress
    from labrun.spec.experiment import Value
    from labrun.store.trial import TrialOutcome


class BestSoFar:
    """A progress display that hears of the best condition as well; everything else is passed on.

    The best so far is the best mean among the conditions with the full number of repeats (any, before there is one).
    It is what the search has in hand, and optimistic: the honest best comes at the end of the run.

    Parameters
    ----------
    progress
        Who is told.
    objective, goal, unit
        What is best.
    repeats
        How many accepted trials a condition needs to count in full.
    """

    def __init__(
        self,
        progress: "Progress",
        objective: str,
        goal: Literal["maximise", "minimise"],
        unit: str,
        repeats: int,
    ) -> None:
        self._progress = progress
        self._objective = objective
        self._sign = 1.0 if goal == "maximise" else -1.0
        self._unit = unit
        self._repeats = repeats
        self._sums: dict[object, tuple[int, float]] = {}
        self._best: tuple[bool, float] | None = None

    def __enter__(self) -> Self:
        self._progress.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.__exit__(kind, error, trace)

    def total(self, trials: int | None) -> None:
        """Pass it on."""
        self._progress.total(trials)

    def phase(self, text: str) -> None:
        """Pass it on."""
        self._progress.phase(text)

    def trial(self, outcome: "TrialOutcome", done: int, total: int | None, remaining_s: float | None) -> None:
        """Pass it on, and tell of a new best."""
        self._progress.trial(outcome, done, total, remaining_s)
        if (
            outcome.status != "done"
            or outcome.role == "reference"
            or self._objective not in outcome.objectives
        ):
            return
        key = condition_key(outcome.condition)
        count, total_value = self._sums.get(key, (0, 0.0))
        count, total_value = count + 1, total_value + outcome.objectives[self._objective]
        self._sums[key] = (count, total_value)
        mean = total_value / count
        rank = (count >= self._repeats, self._sign * mean)
        if self._best is None or rank > self._best:
            self._best = rank
            self._progress.best(outcome.condition, mean, self._unit)

    def best(self, condition: "Mapping[str, Value]", value: float, unit: str) -> None:
        """Pass it on."""
        self._progress.best(condition, value, unit)

    def note(self, text: str) -> None:
        """Pass it on."""
        self._progress.note(text)
