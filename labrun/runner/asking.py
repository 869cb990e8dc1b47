"""Results that a person types after a trial: asked for, checked, taken back while not stored, journalled."""

import getpass
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from labrun.devices import Clock, Scene
from labrun.errors import ExperimentError
from labrun.objectives import Asked
from labrun.runner.by_hand import Person

BACK = "back"
_MOST_ANSWERS = 10
"""That are none, to one question: a script that never says anything else would be asked for ever."""
_KEEP = "Enter: that is right.   back: the last answer was wrong."


def scene_answers(scene: Scene | None, clock: Clock) -> Callable[[str], float | str] | None:
    """Return what answers for the person in front of a simulated bench; None if it cannot tell anything."""
    told: Callable[[str], float | str] | None = getattr(scene, "answer", None)
    if scene is None or told is None:
        return None

    def answer(what: str) -> float | str:
        # A bench without sensors has been watched by nobody so far: it moves on when it is looked at.
        scene.observe(list(scene.signals)[:1], np.array([clock.now()]))
        return told(what)

    return answer


class Asking:
    """Asks for the typed results of a trial.

    Parameters
    ----------
    questions
        By the objective's name.
    person
        Who is asked.
    simulated
        Answers in their place, from what the result is read from; None where somebody is there.
    journal
        Keeps every answer: takes an event's name, and its fields.
    wait
        Waits a moment; raises if someone asked to stop.
    """

    def __init__(
        self,
        questions: Mapping[str, Asked],
        person: Person,
        simulated: Callable[[str], float | str] | None,
        journal: Callable[..., None],
        wait: Callable[[], object],
    ) -> None:
        self._questions = questions
        self._person = person
        self._simulated = simulated
        self._journal = journal
        self._wait = wait

    def ask(self, index: int, about: str) -> dict[str, float]:
        """Return the value of each typed result of a trial, in the unit of its objective.

        Parameters
        ----------
        index
            Of the trial.
        about
            Its condition, in words.

        Raises
        ------
        ExperimentError
            Too many answers were none, or the scene of a dry run answers with what is none.
        """
        names = list(self._questions)
        if not names:
            return {}
        if self._simulated is not None:
            typed = [self._of_scene(name) for name in names]
        else:
            typed = self._of_person(names, about)
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
        text = str(self._simulated(question.reads or name))
        try:
            question.number(text)
        except ValueError as error:
            raise ExperimentError(
                f"objective {name}: the scene answers {error}",
                hint="widen the range, or look at the condition",
            ) from error
        return text

    def _of_person(self, names: list[str], about: str) -> list[str]:
        typed: list[str] = []
        while True:
            place = len(typed)
            if place == len(names):
                said = ", ".join(f"{name} = {text}" for name, text in zip(names, typed, strict=True))
                if self._answer(f"{about}: {said}", _KEEP, _kept) == BACK:
                    typed.pop()
                    continue
                return typed
            question = self._questions[names[place]]
            hint = "back: the answer before was wrong." if typed else ""
            answer = self._answer(f"{about}: {question.question}", hint, question.number)
            if answer == BACK and typed:
                typed.pop()
            elif answer != BACK:
                typed.append(answer)

    def _answer(self, text: str, hint: str, check: Callable[[str], object]) -> str:
        """Return the line that was typed once `check` takes it, or `BACK`."""
        problem = ""
        for _ in range(_MOST_ANSWERS):
            lines = [*([f"{problem}."] if problem else []), text, *([f"  {hint}"] if hint else [])]
            self._person.ask("\n".join(lines))
            while (line := self._person.answer()) is None:
                self._wait()
            if line.strip().lower() == BACK:
                return BACK
            try:
                check(line)
            except ValueError as error:
                problem = str(error)
            else:
                return line.strip()
        raise ExperimentError(
            f"{_MOST_ANSWERS} answers to {text!r} were none; the last: {problem}",
            hint="what was recorded of this trial is kept; labrun resume runs it again, and asks again",
        )


def _kept(line: str) -> None:
    if line.strip():
        raise ValueError(f"{line!r} is no answer here: press Enter, or type back")


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "somebody"
