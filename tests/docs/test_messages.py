"""Every message of labrun and its plugins keeps the mechanical part of the rules for messages.

Collected from the source are the texts of every error, fault, note, remark and help text.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = [*sorted((ROOT / "labrun").rglob("*.py")), *sorted((ROOT / "plugins").rglob("*.py"))]
CALLS = re.compile(r".*(Error|Fault|Problem)|fail|note|note_in|Remark|Option|Argument")
"""Calls whose texts a person reads."""
FORMAT = re.compile(r"https?://|^\s*[{<$]|\S+\s{2,}\S.*\n", re.DOTALL)
"""Texts that are addresses, code or tables: blanks and capitals have a meaning there."""

RULES = {
    "writes 'is not a' instead of 'is no', and names what it cannot find": re.compile(
        r"\b(is|are) no\b(?! (longer|more)\b)|\bthere (is|are) no"
    ),
    "has single blanks only": re.compile(r"\S {2,}\S"),
    "does not begin with a blank or with punctuation": re.compile(r"^[\s,;.]"),
    "does not end with a blank": re.compile(r"[ \t]$"),
    "does not end with an exclamation mark": re.compile(r"!$"),
    "does not call what fails an unexpected surprise": re.compile(
        r"\b(oops|sorry|please|unfortunately|something went wrong)\b", re.IGNORECASE
    ),
}
"""What a message does, and what it would show if it did not."""


class Message:
    """A text in the source, with ``{}`` in place of its values."""

    def __init__(self, where: str, call: str, keyword: str, text: str) -> None:
        self.where, self.call, self.keyword, self.text = where, call, keyword, text

    def __repr__(self) -> str:
        return f"{self.where}: {self.call}({self.keyword}{self.text!r})"


def _text(node: ast.expr) -> str | None:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return None


def _alternatives(node: ast.expr) -> Iterator[ast.expr]:
    """Yield what an expression may be: both branches of a conditional."""
    if isinstance(node, ast.IfExp):
        yield from _alternatives(node.body)
        yield from _alternatives(node.orelse)
    else:
        yield node


def _messages() -> list[Message]:
    messages = []
    for path in SOURCES:
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            if name == "note" and not isinstance(call.func, ast.Attribute):
                continue  # a sentence of a report
            if not CALLS.fullmatch(name):
                continue
            arguments = [("", argument) for argument in call.args]
            arguments += [(keyword.arg or "", keyword.value) for keyword in call.keywords]
            for keyword, argument in arguments:
                for alternative in _alternatives(argument):
                    text = _text(alternative)
                    if text is not None and " " in text.strip() and not FORMAT.search(text):
                        where = f"{path.relative_to(ROOT)}:{alternative.lineno}"
                        messages.append(Message(where, name, keyword and f"{keyword}=", text))
    return messages


MESSAGES = _messages()


def test_the_messages_of_all_packages_are_collected():
    packages = {message.where.split("/")[1] for message in MESSAGES if message.where.startswith("labrun/")}
    assert {"app", "cli", "gap", "logs", "runner", "experiment", "store"} <= packages
    assert len(MESSAGES) > 1000


@pytest.mark.parametrize("rule", RULES)
def test_a_message(rule):
    broken = [message for message in MESSAGES if RULES[rule].search(message.text)]
    assert not broken, f"every message {rule}:\n" + "\n".join(map(repr, broken))


def test_errors_and_their_hints_end_without_a_period_and_help_texts_with_one():
    broken = []
    for message in MESSAGES:
        is_help = message.call in ("Option", "Argument")
        if is_help and message.keyword not in ("help=",):
            continue
        ends = message.text.rstrip().endswith(".") and not message.text.rstrip().endswith("...")
        if ends != is_help and not message.text.endswith("{}"):
            broken.append(message)
    assert not broken, "\n".join(map(repr, broken))


def test_an_error_begins_with_what_is_wrong_in_lower_case():
    """A name, a key or a value may begin it; a capital of ordinary prose does not."""
    prose = re.compile(r"^(The|A|An|This|There|It|Its|You|No|Cannot|Invalid|Unknown|Missing|Could)\b")
    broken = [
        message for message in MESSAGES if message.call.endswith("Error") and prose.search(message.text)
    ]
    assert not broken, "\n".join(map(repr, broken))
