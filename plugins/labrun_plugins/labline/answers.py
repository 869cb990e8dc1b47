"""Which answers are awaited, and what has come: requests are told apart by their sequence numbers."""

import itertools
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

from labrun.devices import Clock
from labrun_plugins.labline.codec import LAST_SEQ, Line

_LATE_S = 1.0
"""An answer that comes later than this comes never."""


@dataclass(slots=True)
class Awaited:
    """One request under way.

    Attributes
    ----------
    posted
        Nobody waits for its answer: a set-point, or a sign of life.
    answered, fields
        Set once the answer is there; ``OK`` or ``ERR``, and what stands behind it.
    """

    seq: int
    word: str
    posted: bool
    sent_s: float
    answered: threading.Event = field(default_factory=threading.Event)
    fields: tuple[str, ...] = ()


class Answers:
    """The requests under way.

    No lock guards them: a stop must not wait for a thread that a signal interrupted while it held one. Every single
    operation on numbers and table is atomic.

    Parameters
    ----------
    clock
        The run's clock.

    Attributes
    ----------
    unanswered
        Set-points that never got their answer.
    waiting_since_s
        Since when set-points have stayed unanswered, s; None if none is.
    """

    def __init__(self, clock: Clock) -> None:
        self.unanswered = 0
        self.waiting_since_s: float | None = None
        self._clock = clock
        self._awaited: dict[int, Awaited] = {}
        self._numbers: Iterator[int] = itertools.count()

    def reset(self) -> None:
        """Await nothing; numbers go on."""
        self._awaited.clear()
        self.unanswered, self.waiting_since_s = 0, None

    def expect(self, word: str, *, posted: bool) -> Awaited:
        """Give a request its number; give up set-points whose answer never came."""
        now_s = self._clock.now()
        for older in list(self._awaited.values()):
            if older.posted and now_s - older.sent_s > _LATE_S:
                self.forget(older)
                self.unanswered += 1
        awaited = Awaited(next(self._numbers) % LAST_SEQ + 1, word, posted, now_s)
        self._awaited[awaited.seq] = awaited
        if posted and self.waiting_since_s is None:
            self.waiting_since_s = now_s
        return awaited

    def take(self, line: Line) -> Awaited | None:
        """Return the request that a line answers; None for a line that answers none under way."""
        awaited = self._awaited.get(line.seq)
        if awaited is None or line.word not in {"OK", "ERR"}:
            return None  # late, repeated or a stranger's: whoever asked has given up
        if line.word == "OK" and line.fields[1:2] != (awaited.word,):
            return None  # the answer to an older request of the same number
        self.waiting_since_s = None
        if awaited.posted:
            self.forget(awaited)
        awaited.fields = line.fields
        awaited.answered.set()
        return awaited

    def withdraw(self, awaited: Awaited) -> None:
        """Take back a set-point that was not sent after all."""
        self.forget(awaited)
        if self.waiting_since_s == awaited.sent_s:
            self.waiting_since_s = None

    def forget(self, awaited: Awaited) -> None:
        """Await an answer no longer."""
        self._awaited.pop(awaited.seq, None)
