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
        began, lock = time.perf_counter(), threading.Lock()
        done, reported = 0, began

        def counted(item: Argument) -> Result:
            nonlocal done, reported
            self.check()
            result = work(item)
            with lock:
                done += 1
                now = time.perf_counter()
                if now - reported >= _EVERY_S:
                    reported = now
                    remaining_s = (now - began) / done * (len(items) - done)
                    self.note(f"{step}: {done} of {len(items)}, about {remaining_s:.0f} s left in this step")
            return result

        if len(items) > 1:
            self.note(f"{step}: 0 of {len(items)}")
        return self._each(counted, items)

    def check(self) -> None:
        """Raise `TimeOver` if the deadline has passed."""
        if time.perf_counter() > self._deadline_s:
            raise TimeOver
