"""Run another program as a diagnosis: it gets the folder of a case and prints JSON."""

import hashlib
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import IO, Any

from labrun.blind.jobs import Files
from labrun.errors import RequestError

LIMIT_S = 120.0
"""Wall time of one case, where none is given."""
_LONGEST_OUTPUT = 10_000_000
_LAST_LINES = 3
_SHOWN = 80


@dataclass(frozen=True, slots=True)
class Tool:
    """A program that diagnoses: it takes the folder of a recording as its last argument and prints JSON.

    Attributes
    ----------
    name
        Of its column in the table: the script that the command names, or the program.
    command
        Program and arguments, without the folder.
    limit_s
        Wall time that it may take for one case.
    """

    name: str
    command: tuple[str, ...]
    limit_s: float = LIMIT_S

    @property
    def fingerprint(self) -> str:
        """A hash of the command, its time limit and the files that it names: answers of an edited script are stale."""
        hashed = hashlib.sha256(repr((self.command, self.limit_s)).encode())
        for path in _files_of(self.command):
            hashed.update(path.read_bytes())
        return hashed.hexdigest()[:16]


def tools_of(commands: Sequence[str], limit_s: float = LIMIT_S) -> tuple[Tool, ...]:
    """Read commands as they are typed; no two tools get the same name.

    Raises
    ------
    RequestError
        An empty command, an unclosed quote, a program that does not exist, or no time at all.
    """
    if limit_s <= 0:
        raise RequestError(
            f"a time limit of {limit_s:g} s leaves a tool no time", hint="write for example 60"
        )
    tools: list[Tool] = []
    for text in commands:
        try:
            command = tuple(shlex.split(text))
        except ValueError as error:
            raise RequestError(f"--tool {text!r} cannot be split into words: {error}") from None
        if not command:
            raise RequestError(
                "--tool is empty", hint='name a program, for example --tool "python my_method.py"'
            )
        if shutil.which(command[0]) is None:
            raise RequestError(
                f"--tool: the program {command[0]!r} does not exist or is not executable",
                hint='a Python script is started by its interpreter: --tool "python my_method.py"',
            )
        base = _name_of(command)
        names = {"labrun", *(tool.name for tool in tools)}
        numbered = (base if number == 1 else f"{base}-{number}" for number in range(1, len(commands) + 2))
        tools.append(Tool(next(name for name in numbered if name not in names), command, limit_s))
    return tuple(tools)


def ask_tool(tool: Tool, case: str, files: Files) -> dict[str, Any]:
    """Run a tool on the files of one case.

    Returns
    -------
    dict
        The JSON object that it printed, or ``error`` with the reason why there is none; with both ``processor_s``, the
        processor seconds of the program and all that it started and waited for.
    """
    with TemporaryDirectory(prefix="labrun-check-") as made:
        folder = Path(made) / case
        folder.mkdir()
        for name, content in files.items():
            (folder / Path(name).name).write_bytes(content)
        before = _children_s()
        with (Path(made) / "stdout").open("w+b") as output, (Path(made) / "stderr").open("w+b") as messages:
            reason = _run([*tool.command, str(folder)], tool.limit_s, output, messages)
            printed = {"error": reason} if reason else _printed(output)
        return {**printed, "processor_s": round(_children_s() - before, 3)}


def _run(command: Sequence[str], limit_s: float, output: IO[bytes], messages: IO[bytes]) -> str:
    """Run a command in a process group of its own; return why it failed, or ""."""
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=messages, start_new_session=True
        )
    except OSError as error:
        return f"cannot be started: {error}"
    try:
        with _exit_on_termination():
            code = process.wait(limit_s)
    except subprocess.TimeoutExpired:
        return f"not finished within {limit_s:g} s"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    if code == 0:
        return ""
    messages.seek(0)
    lines = messages.read(_LONGEST_OUTPUT).decode(errors="replace").strip().splitlines()
    ended = f"ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
    return ": ".join([ended, *([" / ".join(lines[-_LAST_LINES:])] if lines else [])])


def _printed(output: IO[bytes]) -> dict[str, Any]:
    output.seek(0)
    text = output.read(_LONGEST_OUTPUT).decode(errors="replace").strip()
    if not text:
        return {"error": "printed nothing on standard output"}
    try:
        printed = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        return {
            "error": f"standard output is not one JSON object ({error}); it begins with {text[:_SHOWN]!r}"
        }
    if not isinstance(printed, dict):
        return {"error": f"printed {type(printed).__name__}, not a JSON object: {text[:_SHOWN]!r}"}
    return {str(key): value for key, value in printed.items() if key != "error"}


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not a JSON number")


def _children_s() -> float:
    """Return the processor time of all ended children of this process, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def _exit_on_termination() -> Iterator[None]:
    """Let SIGTERM raise SystemExit, so that a worker that is stopped does not leave its tool running."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    previous = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def _files_of(command: Sequence[str]) -> list[Path]:
    return [Path(word) for word in command[1:] if Path(word).is_file()]


def _name_of(command: Sequence[str]) -> str:
    files = _files_of(command)
    name = files[0].stem if files else Path(command[0]).name
    return "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in name)
