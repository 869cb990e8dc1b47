"""Somebody at the bench who is asked, and what lines mean."""

from collections.abc import Callable
from typing import Protocol, TypeVar

from labrun.errors import ExperimentError

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
    raise ExperimentError(f"{_MOST_ANSWERS} answers to {text!r} were none; the last: {problem}", hint=hint)


class Willing:
    """Has always done what was asked: the person of a simulated bench."""

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
