"""What a page tells its reader to type: commands, Python, and files, in order."""

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(
    r"^(?:<!-- (?P<mark>no-run|slow): (?P<reason>[^\n]+?) -->\n+)?(?P<indent> *)```(?P<language>\w+)(?P<info>[^\n]*)\n"
    r"(?P<body>.*?)^(?P=indent)```$",
    re.MULTILINE | re.DOTALL,
)
_TITLE = re.compile(r'title="([^"]+)"')


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    page: str
    line: int
    language: str
    info: str
    body: str
    reason: str | None
    """Why it is not run; None if it is."""
    slow: bool = False
    """Whether it is run with the slow tests only."""

    @property
    def file(self) -> str | None:
        """The file it shows, which the reader makes."""
        match = _TITLE.search(self.info)
        return match[1] if match else None

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"


@dataclass(frozen=True)
class Command:
    """One command line, and what the page shows of its output."""

    line: str
    shown: tuple[str, ...] = ()


def blocks(path: Path) -> list[Block]:
    """Return the fenced blocks of a page.

    A comment ``<!-- no-run: why -->`` before a block says why it is not run, ``<!-- slow: why -->`` why only the slow
    tests run it.
    """
    text = path.read_text(encoding="utf-8")
    results = []
    for match in _FENCE.finditer(text):
        line = text[: match.start("language")].count("\n") + 1
        reason = match["reason"] if match["mark"] == "no-run" else None
        if match["info"].strip() == "set-up":
            reason = "makes an environment of its own; the server runs it in a fresh copy"
        results.append(
            Block(
                path.name,
                line,
                match["language"],
                match["info"],
                textwrap.dedent(match["body"]),
                reason,
                slow=match["mark"] == "slow",
            )
        )
    return results


def commands(block: Block) -> list[Command]:
    """Return the command lines of a console block (after ``$``) or of a shell block (every line)."""
    lines = block.body.splitlines()
    if block.language == "sh":
        return [Command(line) for line in _joined(lines) if line and not line.startswith("#")]
    results: list[tuple[str, list[str]]] = []
    for line in _joined(lines):
        if line.startswith("$ "):
            results.append((line[2:], []))
        elif results:
            results[-1][1].append(line)
        elif line.strip():
            raise ValueError(f"{block.where}: a console block begins with '$ ', not with {line!r}")
    return [Command(line, tuple(shown)) for line, shown in results]


def _joined(lines: list[str]) -> list[str]:
    joined: list[str] = []
    for line in lines:
        if joined and joined[-1].endswith("\\"):
            joined[-1] = joined[-1][:-1] + line.strip()
        else:
            joined.append(line)
    return joined


def unlike(shown: tuple[str, ...], printed: str) -> list[str]:
    """Return the shown lines that were not printed, in their order.

    Numbers, times and names of runs differ from one run to the next: of each line, what stands before the first of
    them must begin a printed line, after the one that the line above was found in. A line ``...`` stands for any.
    """
    rest = iter([_start(line) for line in printed.splitlines()])
    missing = []
    whole = " ".join(printed.split())  # pages wrap long lines
    for line in shown:
        wanted = _start(line)
        if not wanted or wanted == "...":
            continue
        if not any(candidate.startswith(wanted) for candidate in rest):
            if wanted not in whole:
                missing.append(line)
            rest = iter([_start(text) for text in printed.splitlines()])
    return missing


def _start(line: str) -> str:
    line = re.sub(r"(?<=\s)/\S+/", "", line)  # a path of this machine: its last part
    before = re.split(r"[-+]?\d|─", line, maxsplit=1)[0]
    return " ".join(before.split()).removesuffix("-").strip()
