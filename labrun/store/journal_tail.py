"""A journal that another process writes, read as it grows."""

from datetime import datetime
from pathlib import Path
from typing import Any

from labrun.store.journal import parse_events


class JournalTail:
    """Reads what is new in a ``journal.jsonl``; never writes, never locks.

    What a reader on another machine may see is taken as it comes: a file that is not there (yet, or any more), a last
    line that is torn or not all there, a torn line that a resumed run has cut off.

    Attributes
    ----------
    changed_utc_s
        When the file was last written, by the clock of the file's server, in s since 1970; None without a file.
    unreadable
        Number of lines that are no events although whole lines follow.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.changed_utc_s: float | None = None
        self.unreadable = 0
        self._offset = 0

    def read(self) -> tuple[list[dict[str, Any]], bool]:
        """Return the events that are new, and whether the journal began anew, so that these are all."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                anew = size < self._offset
                if anew:
                    self._offset = self.unreadable = 0
                file.seek(self._offset)
                content = file.read()
            self.changed_utc_s = self.path.stat().st_mtime
        except OSError:  # no file yet, none any more, or a network folder that does not answer just now
            return [], False
        lines = content[: content.rfind(b"\n") + 1].splitlines(keepends=True)
        events: list[dict[str, Any]] = []
        unreadable = 0
        for line in lines:
            event = _event(line)
            if event is None:
                unreadable += 1
                continue
            # Whole lines stand after what could not be read: it will not come right any more.
            self.unreadable += unreadable
            unreadable = 0
            events.append(event)
        trailing = sum(len(line) for line in lines[len(lines) - unreadable :])
        self._offset += sum(len(line) for line in lines) - trailing
        return events, anew


def stamp_s(event: dict[str, Any]) -> float | None:
    """Return when an event was written, by the clock of the machine that runs, in s since 1970."""
    try:
        return datetime.fromisoformat(event["time_utc"]).timestamp()
    except (KeyError, TypeError, ValueError):
        return None


def _event(line: bytes) -> dict[str, Any] | None:
    from labrun.errors import RecordingError

    try:
        (event,) = parse_events(line, "journal")
    except (RecordingError, ValueError):
        return None
    return event
