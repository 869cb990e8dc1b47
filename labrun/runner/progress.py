"""What a run tells whoever watches it."""

from collections.abc import Mapping
from types import TracebackType
from typing import Protocol, Self

from labrun.store import TrialOutcome


class Progress(Protocol):
    """Told by the runner and the searches what goes on; draws it, or not."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def total(self, trials: int | None) -> None:
        """Set the greatest number of trials there can be; None if nobody can know."""
        ...

    def phase(self, text: str) -> None:
        """Say what is happening now: "settle", "record"."""
        ...

    def trial(self, outcome: TrialOutcome, done: int, total: int | None, remaining_s: float | None) -> None:
        """Report a trial that has just been stored."""
        ...

    def best(self, condition: Mapping[str, float | str], value: float, unit: str) -> None:
        """Report the best condition so far."""
        ...

    def note(self, text: str) -> None:
        """Report something worth a line."""
        ...


class SilentProgress:
    """Says nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def total(self, trials: int | None) -> None:
        """Ignore it."""

    def phase(self, text: str) -> None:
        """Ignore it."""

    def trial(self, outcome: TrialOutcome, done: int, total: int | None, remaining_s: float | None) -> None:
        """Ignore it."""

    def best(self, condition: Mapping[str, float | str], value: float, unit: str) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""
