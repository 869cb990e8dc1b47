"""What a long search reports while it runs, and when its time is over."""

import threading
import time
from collections.abc import Callable, Iterable
from typing import TypeVar

from labrun.fit import Each, Note

Argument = TypeVar("Argument")
Result = TypeVar("Result")

_EVERY_S = 0.2
"""Time between two reports on one step, s."""


class TimeOver(Exception):  # noqa: N818 - an event that ends a search with its best answer so far, not an error
    """The time that a search was given is over."""


class Count:
    """How many of some items are done, and about how long the others take.

    Parameters
    ----------
    total
        Number of items.
    """

    def __init__(self, total: int) -> None:
        self.total, self.done = total, 0
        self._start_s = time.perf_counter()

    @property
    def time_left(self) -> str:
        """Return "about 12 s left"; "" before the first item is done, and after the last."""
        if not 0 < self.done < self.total:
            return ""
        left_s = (time.perf_counter() - self._start_s) / self.done * (self.total - self.done)
        return f"about {left_s:.0f} s left"


class Progress:
    """Reports how much of a step is done, and raises `TimeOver` at the deadline.

    Parameters
    ----------
    each
        How the items of a step are worked on.
    note
        Called with a line of text.
    deadline_s
        By `time.perf_counter`; infinite without a time limit.
    """

    def __init__(self, each: Each, note: Note, deadline_s: float = float("inf")) -> None:
        self._each, self.note, self._deadline_s = each, note, deadline_s

    def __call__(
        self, step: str, work: Callable[[Argument], Result], items: Iterable[Argument]
    ) -> list[Result]:
        """Return what `work` gives for every item, reporting "`step`: 3 of 40, about 12 s left"."""
        items = list(items)
        count, lock = Count(len(items)), threading.Lock()
        reported = time.perf_counter()

        def counted(item: Argument) -> Result:
            nonlocal reported
            self.check()
            result = work(item)
            with lock:
                count.done += 1
                now = time.perf_counter()
                if now - reported >= _EVERY_S:
                    reported = now
                    left = f", {count.time_left} in this step" if count.time_left else ""
                    self.note(f"{step}: {count.done} of {count.total}{left}")
            return result

        if len(items) > 1:
            self.note(f"{step}: 0 of {len(items)}")
        return self._each(counted, items)

    def check(self) -> None:
        """Raise `TimeOver` if the deadline has passed."""
        if time.perf_counter() > self._deadline_s:
            raise TimeOver
