"""Standard output and error of the command line, on a full disk or a terminal that was closed as well."""

import io
import os
import sys
from typing import Any

from labrun.errors import LabrunError


class OutputError(LabrunError):
    """Standard output cannot be written."""


class _Output(io.FileIO):
    """Standard output. The first failure is raised; what follows goes nowhere, so that the process can end."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:  # ``labrun list | head``: nobody wants more
            raise
        except OSError as error:
            _send_nowhere(self.fileno())
            raise OutputError(
                f"standard output cannot be written: {error.strerror}",
                hint="the command did its work, and its files are kept; free space where the output goes, "
                "or send it elsewhere",
            ) from error


class _Messages(io.FileIO):
    """Standard error; its failures are ignored, so that no run ends because of them."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            _send_nowhere(self.fileno())
            return len(data)


def _send_nowhere(file: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, file)
    os.close(nowhere)


def guard_streams() -> None:
    """Replace standard output and error by streams that fail as a person at the bench needs it."""
    for name, kind in (("stdout", _Output), ("stderr", _Messages)):
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper):  # closed from the beginning, or somebody reads along
            continue
        try:
            raw = kind(stream.fileno(), "w", closefd=False)
        except (OSError, ValueError):
            continue
        guarded = io.TextIOWrapper(
            io.BufferedWriter(raw),
            encoding=stream.encoding,
            errors=stream.errors,
            line_buffering=stream.line_buffering or name == "stderr",
        )
        setattr(sys, name, guarded)


def complain(message: str) -> None:
    """Print a message of labrun on standard error."""
    print(f"labrun: {message}", file=sys.stderr, flush=True)
