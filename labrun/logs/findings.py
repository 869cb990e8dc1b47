"""What reading a log found: statements, which tell what was done, and questions, which a person has to answer."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from labrun.errors import RequestError


@dataclass(frozen=True, slots=True)
class Statement:
    """What the log holds or what was done with it, with its numbers.

    Attributes
    ----------
    text
    channel
        The channel of the model that it is about; "" for all of the log.
    """

    text: str
    channel: str = ""


@dataclass(frozen=True, slots=True)
class Question:
    """A doubt that only a person can settle.

    Attributes
    ----------
    text
        What is in doubt, with the numbers.
    proposal
        The flags that answer it in the most likely way, such as ``--unit deg``; "" where nothing is likely.
    answers
        The flags that answer it otherwise.
    channel
        The channel of the model that it is about; "" for all of the log.
    """

    text: str
    proposal: str = ""
    answers: str = ""
    channel: str = ""

    def to_json(self) -> dict[str, str | None]:
        """Return the fields by name."""
        return {
            "text": self.text,
            "proposal": self.proposal or None,
            "answers": self.answers,
            "channel": self.channel,
        }

    def to_text(self) -> str:
        """Return question, proposal and other answers in one line."""
        ends = [f"proposal: {self.proposal}"] if self.proposal else []
        return "; ".join([self.text, *ends, *([self.answers] if self.answers else [])])


Finding = Statement | Question


def statements(findings: Sequence[Finding]) -> list[str]:
    """Return the sentences that ask nothing, each once."""
    return list(dict.fromkeys(finding.text for finding in findings if isinstance(finding, Statement)))


def questions(findings: Sequence[Finding]) -> list[Question]:
    """Return what is in doubt, each doubt once."""
    return list(dict.fromkeys(finding for finding in findings if isinstance(finding, Question)))


def require_answered(findings: Sequence[Finding], columns: Sequence[str]) -> None:
    """Raise RequestError with every open question, and with one line that accepts all proposals.

    `columns`: what the log has, for answers that name one.
    """
    open_questions = questions(findings)
    if not open_questions:
        return
    shown = ", ".join(columns[:30]) + (f" and {len(columns) - 30} more" if len(columns) > 30 else "")
    lines = "\n".join(f"  {question.to_text()}" for question in open_questions)
    proposals = [
        shlex.join(question.proposal.split(" ", 1)) for question in open_questions if question.proposal
    ]
    hint = "answer each with its flag"
    if len(proposals) == len(open_questions):
        hint += f"; if all proposals are right: {' '.join(dict.fromkeys(proposals))}"
    elif proposals:
        hint += f"; those with a proposal: {' '.join(dict.fromkeys(proposals))}"
    raise RequestError(f"the log leaves questions open:\n{lines}\nthe log has {shown}", hint=hint)
