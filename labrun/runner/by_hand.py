"""What a person mounts: one question a change, and answers that may be taken back."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from labrun.experiment import ByHand, Condition, condition_key, condition_text
from labrun.runner.asking import Meant, Person, answered
from labrun.runner.measurement import Order, block_order
from labrun.store import Journal

SET_ASIDE = "set aside: "
"""Begins the reason of every trial of a mounting that was taken back."""
_EVENT = "mounting"
_ROUND = 1 << 32
_CHANGE = "Enter: it is in place.   back: the last one was wrong.   back 3: mounting 3 was wrong."
_END = "Enter: all of them were right.   back: the last one was wrong.   back 3: mounting 3 was wrong."
_STILL = "Enter: it is still mounted.   again: it was taken out; mount it again and repeat its trials."


@dataclass(frozen=True, slots=True)
class Mounting:
    """One block of trials.

    Attributes
    ----------
    number
        Counts the mountings of a run from 1; None where nothing is set by hand.
    values
        What is set by hand.
    positions
        Which of the conditions asked for are measured in it.
    last
        Which come when all others are done: they damage what is mounted.
    """

    number: int | None
    values: Condition
    positions: tuple[int, ...]
    last: tuple[int, ...] = ()

    def __iter__(self) -> Iterator[int]:
        """Give every position."""
        return iter((*self.positions, *self.last))


class Mountings:
    """Deals out the blocks of a run, and asks for each.

    Resuming is replay: answers that the journal holds are taken from there, at the trial before which they were given.

    Parameters
    ----------
    table
        Of the experiment file; None if nothing is set by hand.
    units
        Of conditions.
    wait
        Waits a moment; raises if someone asked to stop.
    set_aside
        Takes back the trials of a mounting by its number.
    wanted
        Tells whether anything is left to measure in a block; others are not asked for.
    keeps
        What is mounted stays for whatever is measured next with the same values, as by a search: nobody is asked
        between its generations, and none of them can be taken back.
    """

    def __init__(
        self,
        table: ByHand | None,
        units: Mapping[str, str],
        person: Person,
        journal: Journal,
        wait: Callable[[], object],
        set_aside: Callable[[int], object],
        wanted: Callable[[Mounting], bool],
        keeps: bool,
    ) -> None:
        self._keeps = keeps
        self._kept: Mounting | None = None
        self._table = table
        self._units = units
        self._person = person
        self._journal = journal
        self._wait = wait
        self._set_aside = set_aside
        self._wanted = wanted
        events = journal.events() if table is not None else []
        self._given = deque(event for event in events if event["event"] == _EVENT)
        self._coming: deque[Mounting] = deque()
        self._mounted: list[Mounting] = []
        self._count = 0
        self._seen: int | None = None

    def plan(
        self,
        conditions: Sequence[Condition],
        order: Order,
        *,
        seed: int,
        trial_index: int,
        damages: Callable[[Condition], bool] = lambda _: False,
    ) -> None:
        """Start a new plan of mountings: each group of equal values as often as the file states, in rounds.

        Those that damage are left to the last round, and to the end of their block.
        """
        self._mounted = []
        self._coming = deque()
        groups: dict[object, list[int]] = {}
        for position, condition in enumerate(conditions):
            values = {} if self._table is None else self._table.values(condition)
            groups.setdefault(condition_key(values), []).append(position)
        blocks = []
        for positions in groups.values():
            values = {} if self._table is None else self._table.values(conditions[positions[0]])
            last = tuple(position for position in positions if damages(conditions[position]))
            kept = tuple(position for position in positions if position not in last)
            blocks.append(Mounting(None, values, kept, last))
        if self._keeps and self._kept is not None and [b.values for b in blocks] == [self._kept.values]:
            self._coming.append(replace(blocks[0], number=self._kept.number))
            return
        rounds = 1 if self._table is None else self._table.mountings
        for turn in range(rounds):
            index = turn * _ROUND + trial_index
            for block_index in block_order(range(len(blocks)), order, seed=seed, trial_index=index):
                block = blocks[block_index] if turn == rounds - 1 else replace(blocks[block_index], last=())
                if tuple(block):
                    self._coming.append(block)

    def next(self, index: int) -> Mounting | None:
        """Return the next block, once it is mounted; None at the end. `index` is that of the next trial."""
        if self._table is None:
            return self._coming.popleft() if self._coming else None
        while self._coming or self._mounted:
            while self._coming and not self._wanted(self._coming[0]):
                self._coming.popleft()
            coming = self._coming[0] if self._coming else None
            if self._keeps and (coming is None or coming.number is not None):
                return self._coming.popleft() if coming is not None else None
            event = self._recorded(index)
            if event is None:
                answers = _END if coming is None else _CHANGE
                wrong = self._asked(self._question(coming), answers, self._meant)
                self._seen = self._count + 1
            else:
                self._given.popleft()
                wrong = None if event["answer"] == "mounted" else self._numbered(event["number"])
            if wrong is not None:
                self._take_back(wrong, index, known=event is not None)
            elif coming is None:
                return None
            else:
                self._coming.popleft()
                self._count += 1
                made = self._kept = replace(coming, number=self._count)
                self._mounted.append(made)
                if event is None:
                    self._keep(index, "mounted", made)
                return made
        return None

    def in_place(self, mounting: Mounting, index: int, *, stored: bool) -> bool:
        """Tell whether a mounting is there for the trial with this index; if not, its trials are taken back.

        Asked only where an earlier session left it, before the first trial that is not stored.
        """
        if mounting.number is None:
            return True
        known = self._recorded(index) is not None  # in the midst of a block only this is ever answered
        if not known and (stored or self._seen == mounting.number):
            return True
        if not known:
            text = f"{self._name(mounting)} was in place when the run stopped. Is it still?"
            self._seen = mounting.number
            if not self._asked(text, _STILL, _again) or self._keeps:
                return True
        else:
            self._given.popleft()
        self._take_back(mounting, index, known=known)
        return False

    def _question(self, coming: Mounting | None) -> str:
        table = self._table
        if coming is None or table is None:
            return f"All is measured. The last: {self._name(self._mounted[-1])}."
        last = self._mounted[-1] if self._mounted else None
        first = (
            "Take it out and mount it again: " if last is not None and last.values == coming.values else ""
        )
        total = self._count + len(self._coming)
        return (
            f"{first}{table.instruction(coming.values, self._units)} (mounting {self._count + 1} of {total})"
        )

    def _name(self, mounting: Mounting) -> str:
        return f"mounting {mounting.number} ({condition_text(mounting.values, self._units)})"

    def _meant(self, line: str) -> Mounting | None:
        """Return the mounting that a person takes back, None for none; ValueError says what cannot be meant."""
        word, _, number = line.partition(" ")
        if not line:
            return None
        if word not in ("back", "no", "b") or not (number == "" or number.strip().isdigit()):
            raise ValueError(f"{line!r} is not an answer")
        if not self._mounted:
            raise ValueError("no earlier mounting can be taken back")
        if not number:
            return self._mounted[-1]
        meant = self._numbered(int(number))
        if meant is None:
            known = ", ".join(str(item.number) for item in self._mounted)
            raise ValueError(f"unknown mounting {number.strip()}; mountings so far: {known}")
        return meant

    def _numbered(self, number: int) -> Mounting | None:
        return next((item for item in self._mounted if item.number == number), None)

    def _asked(self, text: str, answers: str, meaning: Callable[[str], Meant]) -> Meant:
        return answered(
            self._person,
            self._wait,
            text,
            answers,
            lambda line: meaning(line.strip().lower()),
            "the answers are: " + answers,
        )

    def _take_back(self, mounting: Mounting, index: int, *, known: bool) -> None:
        """Set the trials of a mounting aside, and let it come once more, as the next."""
        if not known:
            self._keep(index, "back", mounting)
        self._mounted = [item for item in self._mounted if item.number != mounting.number]
        self._coming.appendleft(replace(mounting, number=None))
        self._set_aside(mounting.number or 0)

    def _recorded(self, index: int) -> Mapping[str, Any] | None:
        return self._given[0] if self._given and self._given[0]["at_trial"] == index else None

    def _keep(self, index: int, answer: str, mounting: Mounting) -> None:
        self._journal.append(
            _EVENT, at_trial=index, answer=answer, number=mounting.number, values=dict(mounting.values)
        )


def _again(line: str) -> bool:
    if line not in ("", "again"):
        raise ValueError(f"{line!r} is not an answer")
    return line == "again"
