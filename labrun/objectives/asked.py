"""A result that a person types: a number that was read from a watch or a video, or a choice."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field, model_validator

from labrun.errors import ExperimentError, SpecError
from labrun.objectives.protocol import TrialSignals
from labrun.toml import Expression, ExpressionError, Table, TableFaults, checked

ASKED = "asked"
"""The objective by name."""
ANSWER = "answer"
"""What the typed number is called in `value`."""


class AskedSettings(Table):
    """Keys of `asked`.

    Attributes
    ----------
    question
        What the person is asked after each trial.
    least, most
        Range of a number; an answer outside it is asked for again.
    choices
        Words to choose from, instead of a number: each counts as its place in the list, from 0.
    value
        What becomes of the number, an expression in ``answer``: ``360 / answer`` makes deg/s of seconds per turn.
    unit
        Of that value.
    reads
        What the scene of a dry run answers with; the objective's own name if not given.
    """

    question: str
    least: float | None = None
    most: float | None = None
    choices: list[str] | None = Field(default=None, min_length=2)
    value: Expression = Expression.of(ANSWER)
    unit: str = "1"
    reads: str | None = None

    @model_validator(mode="after")
    def _number_or_choice(self) -> "AskedSettings":
        with TableFaults() as faults:
            if self.choices is not None and (self.least is not None or self.most is not None):
                faults.add("choices", "least and most belong to a number; a choice is one of its words")
            if self.least is not None and self.most is not None and not self.least < self.most:
                faults.add("most", f"{self.most:g} is not above least = {self.least:g}", of=("least", "most"))
            unknown = sorted(set(self.value.names) - {ANSWER})
            if unknown:
                faults.add("value", f'knows "{ANSWER}" alone, not {", ".join(unknown)}')
        return self


class Asked:
    """What a person answers after the trial, checked when it is typed."""

    Settings: ClassVar[type[AskedSettings]] = AskedSettings
    needs_channel: ClassVar[bool] = False

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        if channel is not None:
            raise SpecError('"asked" takes no channel, because a person answers')
        self._keys = checked(AskedSettings, settings)
        self.reads = self._keys.reads

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return the unit of the value."""
        return self._keys.unit

    @property
    def question(self) -> str:
        """What is asked, with what would be an answer."""
        return f"{self._keys.question} ({self._wanted})"

    def number(self, typed: str) -> float:
        """Return the number behind an answer.

        Raises
        ------
        ValueError
            It is none: says what was typed, and what would do.
        """
        typed = typed.strip()
        choices = self._keys.choices
        if choices is not None:
            near = [
                index
                for index, word in enumerate(choices)
                if typed and word.lower().startswith(typed.lower())
            ]
            exact = [index for index, word in enumerate(choices) if word.lower() == typed.lower()]
            if len(exact or near) != 1:
                raise ValueError(f"{typed!r} is not one of the choices; {self._wanted}")
            return float((exact or near)[0])
        try:
            number = float(typed.replace(",", "."))
        except ValueError:
            raise ValueError(f"{typed!r} is not a number; {self._wanted}") from None
        least, most = self._keys.least, self._keys.most
        if (
            not math.isfinite(number)
            or (least is not None and number < least)
            or (most is not None and number > most)
        ):
            raise ValueError(f"{typed} is out of range; {self._wanted}")
        try:
            made = float(self._keys.value({ANSWER: number}))
        except ExpressionError as error:
            raise ValueError(f"cannot evaluate {typed}: {error}") from None
        if not math.isfinite(made):
            raise ValueError(f"cannot evaluate {typed}: {self._keys.value.text} is {made}")
        return number

    def value(self, number: float) -> float:
        """Return what the answer's number counts as."""
        return float(self._keys.value({ANSWER: number}))

    def __call__(self, signals: TrialSignals) -> float:  # noqa: ARG002
        """Raise ExperimentError: the answer of a person was not recorded."""
        raise ExperimentError("no answer was recorded in this trial")

    @property
    def _wanted(self) -> str:
        if self._keys.choices is not None:
            return "one of " + ", ".join(self._keys.choices)
        least, most = self._keys.least, self._keys.most
        if least is None and most is None:
            return "a number"
        if least is None:
            return f"a number up to {most:g}"
        return f"a number from {least:g}" + ("" if most is None else f" to {most:g}")
