"""A progress log file for long computations."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from labrun.fit import Note

_EVERY_S = 1.0
"""Time between two lines, s."""


def progress_file(folder: Path) -> Path:
    """Return the path of the progress log beside `folder`."""
    return folder.with_name(f"{folder.name}-progress.log")


@contextmanager
def logged(note: Note, file: Path) -> Iterator[Note]:
    """Yield a note function that also appends time-stamped lines to a file, at most one every few seconds.

    The folder of `file` is made. The last note is always written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    last, pending = -_EVERY_S, ""
    with file.open("a", encoding="utf-8") as log:

        def write(text: str) -> None:
            log.write(f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC  {text}\n")
            log.flush()

        def both(text: str) -> None:
            nonlocal last, pending
            note(text)
            pending = text
            if time.monotonic() - last >= _EVERY_S:
                last, pending = time.monotonic(), ""
                write(text)

        try:
            yield both
        finally:
            if pending:
                write(pending)
