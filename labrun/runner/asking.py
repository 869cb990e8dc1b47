"""Somebody at the bench who is asked, what lines mean, and results of a trial that are typed."""

import getpass
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Protocol, TypeVar

import numpy as np

from labrun.devices import Clock, Scene
from labrun.errors import ExperimentError
from labrun.objectives import Asked

_MOST_ANSWERS = 10
"""That cannot be meant, to one question: a script that never says anything else would be asked for ever."""


class Person(Protocol):
    """Somebody who is asked, and answers with a line."""

    def ask(self, text: str) -> None:
        """Show a question; an answer from before does not count."""
        ...

    def answer(self) -> str | None:
        """Return the line that was typed since `ask`, without its end; None while there is none. Does not wait."""
        ...


Meant = TypeVar("Meant")


def answered(
    person: Person,
    wait: Callable[[], object],
    text: str,
    answers: str,
    meaning: Callable[[str], Meant],
    hint: str,
) -> Meant:
    """Ask a person until a line means something.

    Parameters
    ----------
    wait
        Waits a moment; raises if someone asked to stop.
    text, answers
        The question, and what can be answered.
    meaning
        Returns what a line means; raises ValueError, which says why it is none.
    hint
        What to do where `_MOST_ANSWERS` lines were none.
    """
    lines = [text, *([f"  {answers}"] if answers else [])]
    problem = ""
    for _ in range(_MOST_ANSWERS):
        person.ask("\n".join([f"{problem}.", *lines] if problem else lines))
        while (line := person.answer()) is None:
            wait()
        try:
            return meaning(line)
        except ValueError as error:
            problem = str(error)
    raise ExperimentError(
        f"no valid answer to {text!r} after {_MOST_ANSWERS} attempts; the last: {problem}", hint=hint
    )


class AutoConfirm:
    """Confirm every request at once, as the person at a simulated bench does."""

    def ask(self, text: str) -> None:
        """Do it."""

    def answer(self) -> str:
        """Say that it is done."""
        return ""


class Scripted:
    """A function of a script in a person's place: question in, answer out."""

    def __init__(self, function: Callable[[str], str]) -> None:
        self._function = function
        self._answer = ""

    def ask(self, text: str) -> None:
        """Ask the function."""
        self._answer = self._function(text)

    def answer(self) -> str:
        """Return what it said."""
        return self._answer


BACK = "back"
_AGAIN = "what was recorded of this trial is kept; labrun resume runs it again, and asks again"
_KEEP = "Enter: that is right.   back: the last answer was wrong."
_BEFORE = "back: what was typed of the trial before was wrong."


class Onlooker:
    """Whoever would read something off a simulated bench: the scene answers in their place.

    A bench without sensors is watched by nobody else, and moves on only when it is looked at.
    """

    def __init__(self, scene: Scene, clock: Clock) -> None:
        self._scene = scene
        self._clock = clock

    @staticmethod
    def of(scene: Scene | None, clock: Clock) -> "Onlooker | None":
        """Return one in front of a scene; None if it cannot tell anything."""
        return Onlooker(scene, clock) if scene is not None and hasattr(scene, "answer") else None

    def look(self) -> None:
        """Look at the bench as it is now."""
        self._scene.observe(list(self._scene.signals)[:1], np.array([self._clock.now()]))

    def read(self, what: str) -> float | str:
        """Return what would be typed."""
        self.look()
        answer: float | str = getattr(self._scene, "answer")(what)  # noqa: B009  (a scene may have none)
        return answer


class Asking:
    """Asks for the typed results of a trial.

    Parameters
    ----------
    questions
        By the objective's name.
    simulated
        Answers in their place, from what the result is read from; None where somebody is there.
    journal
        Keeps every answer: takes an event's name, and its fields.
    wait
        Waits a moment; raises if someone asked to stop.
    may_correct, correct
        Tells of a stored trial whether its values may still change; changes them. Nothing may, if not given.
    """

    def __init__(
        self,
        questions: Mapping[str, Asked],
        person: Person,
        simulated: Onlooker | None,
        journal: Callable[..., None],
        wait: Callable[[], object],
        may_correct: Callable[[int], bool] = lambda _: False,
        correct: Callable[[int, Mapping[str, float]], object] = lambda _, __: None,
    ) -> None:
        self._questions = questions
        self._person = person
        self._simulated = simulated
        self._journal = journal
        self._wait = wait
        self._may_correct = may_correct
        self._correct = correct
        self._before: tuple[int, str] | None = None
        """The trial that was answered last, and its condition in words."""

    def look(self) -> None:
        """Begin to watch a trial."""
        if self._simulated is not None and self._questions:
            self._simulated.look()

    def ask(self, index: int, about: str) -> dict[str, float]:
        """Return the value of each typed result of a trial, in the unit of its objective.

        `index`: of the trial. `about`: its condition, in words. Raises ExperimentError: too many answers were none, or
        the scene of a dry run answers with what is none.
        """
        names = list(self._questions)
        if not names:
            return {}
        if self._simulated is not None:
            typed = [self._of_scene(name) for name in names]
        else:
            before = self._before if self._before is not None and self._may_correct(self._before[0]) else None
            typed = self._of_person(index, names, about, before)
            self._before = index, about
        return self._values(index, names, typed)

    def _values(self, index: int, names: list[str], typed: list[str]) -> dict[str, float]:
        values: dict[str, float] = {}
        for name, text in zip(names, typed, strict=True):
            question = self._questions[name]
            values[name] = question.value(question.number(text))
            self._journal("answered", **self._record(index, name, text, values[name]))
        return values

    def _record(self, index: int, name: str, text: str, value: float) -> dict[str, Any]:
        who = "the scene" if self._simulated is not None else _user()
        when = datetime.now(UTC).isoformat(timespec="seconds")
        return {"index": index, "objective": name, "typed": text, "value": value, "who": who, "when": when}

    def _of_scene(self, name: str) -> str:
        assert self._simulated is not None  # noqa: S101  (asked by the caller)
        question = self._questions[name]
        text = str(self._simulated.read(question.reads or name))
        try:
            question.number(text)
        except ValueError as error:
            raise ExperimentError(
                f"objective {name}: the scene answers {error}",
                hint="widen the range, or look at the condition",
            ) from error
        return text

    def _of_person(
        self, index: int, names: list[str], about: str, before: tuple[int, str] | None = None
    ) -> list[str]:
        """Return the lines that were typed; `before` is the stored trial whose lines may be typed anew."""
        typed: list[str] = []
        while True:
            count = len(typed)
            if count == len(names):
                message = ", ".join(f"{name} = {text}" for name, text in zip(names, typed, strict=True))
                if self._answer(f"{about}: {message}", _KEEP, _kept) == BACK:
                    self._take_back(index, names, typed)
                    continue
                return typed
            question = self._questions[names[count]]
            first = _BEFORE if before is not None else ""
            hint = "back: the answer before was wrong." if typed else first
            answer = self._answer(f"{about}: {question.question}", hint, question.number)
            if answer == BACK and typed:
                self._take_back(index, names, typed)
            elif answer == BACK and before is not None:
                anew = self._of_person(before[0], names, before[1])
                self._correct(before[0], self._values(before[0], names, anew))
            elif answer != BACK:
                typed.append(answer)

    def _take_back(self, index: int, names: list[str], typed: list[str]) -> None:
        """Forget the last line that was typed, but for the journal."""
        text, name = typed.pop(), names[len(typed)]
        question = self._questions[name]
        value = question.value(question.number(text))
        self._journal("taken_back", **self._record(index, name, text, value))

    def _answer(self, text: str, hint: str, check: Callable[[str], object]) -> str:
        """Return the line that was typed once `check` takes it, or `BACK`."""

        def meaning(line: str) -> str:
            if line.strip().lower() == BACK:
                return BACK
            check(line)
            return line.strip()

        return answered(self._person, self._wait, text, hint, meaning, _AGAIN)


def _kept(line: str) -> None:
    if line.strip():
        raise ValueError(f"{line!r} is not an answer here; press Enter, or type back")


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "somebody"
