"""A log file of the progress of long work: a line now and then, beside what the terminal shows."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from labrun.fit import Note

_EVERY_S = 1.0
"""Time between two lines, s."""


def progress_file(folder: Path) -> Path:
    """Return the log file of work whose answer is kept in `folder`; it stands beside the folder."""
    return folder.with_name(f"{folder.name}-progress.log")


@contextmanager
def logged(note: Note, file: Path) -> Iterator[Note]:
    """Give a note that also appends lines with the time of day to a file, at most one every few seconds.

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
