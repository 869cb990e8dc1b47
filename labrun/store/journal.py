"""What a run writes beside its trials: the journal, a line an event, on disk before anything moves; provenance."""

import getpass
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from labrun.devices import Identity
from labrun.errors import RecordingError
from labrun.store.disk import opening, saving, write_all
from labrun.store.trial import json_ready


class Journal:
    """Append-only events of a run in ``journal.jsonl``.

    A torn last line, which is what a power cut leaves, is dropped and told in `torn`; anything unreadable
    before it is an error, because it means that someone edited the file or the disk fails.
    """

    def __init__(self, path: Path, *, durable: bool = True) -> None:
        self.path = path
        self.durable = durable
        """Whether events are on disk before anything moves again; a dry run moves nothing."""
        self.torn: str | None = None
        """What was dropped at the end, after `events` or `repair`; None if nothing was."""
        self._descriptor: int | None = None
        self._unsynced = False

    def append(self, event: str, *, sync: bool = True, **fields: Any) -> None:
        """Write one event.

        Parameters
        ----------
        event
            What happened, for example ``"trial"``.
        sync
            Wait until it is on disk. False only where nothing moves afterwards: the line then becomes durable
            together with the next synced one.
        **fields
            More about it, JSON-ready; `clock_s` is the run clock's time.

        Raises
        ------
        StoreError
            The disk is full or fails; the journal is left as it was.
        """
        stamp = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"event": event, "time_utc": stamp, **fields}, default=json_ready) + "\n"
        with saving(f"journal event {event!r}", self.path.parent):
            descriptor = self._open()
            size = os.fstat(descriptor).st_size
            try:
                write_all(descriptor, line.encode())
                if sync and self.durable:
                    os.fsync(descriptor)
                self._unsynced = not sync and self.durable
            except OSError:
                os.ftruncate(descriptor, size)
                raise

    def sync(self) -> None:
        """Make all events durable."""
        if self._descriptor is not None and self._unsynced:
            with saving("the journal", self.path.parent):
                os.fsync(self._descriptor)
            self._unsynced = False

    def close(self) -> None:
        """Sync and release the file; the next `append` opens it again."""
        if self._descriptor is not None:
            descriptor = self._descriptor
            try:
                self.sync()
            finally:
                os.close(descriptor)
                self._descriptor, self._unsynced = None, False

    def text(self) -> str:
        """Return all whole lines, as they stand in the file; empty if there is no journal yet."""
        content = self._content()
        return content[: self._whole(content)].decode()

    def events(self) -> list[dict[str, Any]]:
        """Return all events in order.

        Raises
        ------
        RecordingError
            A line that is not the last one is unreadable; names file and line.
        """
        content = self._content()
        return parse_events(content[: self._whole(content)], str(self.path))

    def repair(self) -> None:
        """Cut off a torn last line, so that the next event starts on a line of its own."""
        content = self._content()
        whole = self._whole(content)
        if whole < len(content):
            with saving("the journal", self.path.parent), self.path.open("r+b") as file:
                file.truncate(whole)
                os.fsync(file.fileno())

    def _content(self) -> bytes:
        if not self.path.exists():
            return b""
        with opening(self.path):
            return self.path.read_bytes()

    def _whole(self, content: bytes) -> int:
        """Return the length without a torn last line, and note what is torn."""
        end = content.rfind(b"\n") + 1
        if end == len(content) and end > 0:
            start = content.rfind(b"\n", 0, end - 1) + 1
            if _event(content[start:end]) is None:
                end = start
        tail = content[end:]
        self.torn = None
        if tail:
            number = content.count(b"\n", 0, end) + 1
            self.torn = f"{self.path}:{number}: last line torn ({len(tail)} bytes dropped)"
        return end

    def _open(self) -> int:
        if self._descriptor is None:
            self.repair()
            self._descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        return self._descriptor


def remarks_of(events: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return what is to be told of single trials, a sentence each: a learner that died, a command that was bounded."""
    texts = [f"trial {event['index'] + 1}: {event['text']}" for event in events if event["event"] == "remark"]
    return tuple(dict.fromkeys(texts))


def parse_events(content: bytes, source: str) -> list[dict[str, Any]]:
    """Return the events of a journal's whole lines; `source` names the journal in errors."""
    events = []
    for number, line in enumerate(content.splitlines(), start=1):
        event = _event(line)
        if event is None:
            raise RecordingError(
                f"{source}:{number}: not a journal event: {line[:60]!r}",
                hint="later lines are whole, so this is not a power cut: restore the journal from a copy; "
                "the trials themselves are in trials/ or run.h5",
            )
        events.append(event)
    return events


def _event(line: bytes) -> dict[str, Any] | None:
    try:
        event = json.loads(line)
    except ValueError:
        return None
    return event if isinstance(event, dict) and "event" in event else None


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


_PACKAGES = ("labrun", "numpy", "scipy", "h5py", "numba", "cma")
_GIT_TIMEOUT_S = 10


def collect(workspace: Path, *, seed: int, devices: Mapping[str, Identity] | None = None) -> dict[str, Any]:
    """Return what ``provenance.json`` holds, JSON-ready.

    Parameters
    ----------
    workspace
        Folder whose git state is noted, if it has one.
    seed
        All randomness of the run follows from it.
    devices
        What answered, by name.
    """
    return {
        "seed": seed,
        "devices": {name: asdict(identity) for name, identity in (devices or {}).items()},
        **software_and_machine(),
        "git": git_state(workspace),
    }


def software_and_machine() -> dict[str, Any]:
    """Return the command, the versions of what computes, and the machine."""
    return {
        "command": sys.argv,
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "machine": {
            "host": platform.node(),
            "system": platform.platform(),
            "processors": os.cpu_count(),
            "user": _user(),
        },
    }


def git_state(folder: Path) -> dict[str, Any] | None:
    """Return commit and number of changed files of a workspace; None where there is no git or no commit."""
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        changes = _git(folder, "status", "--porcelain")
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit, "changed_files": len(changes.splitlines())}


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S
    ).stdout.strip()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container without a user database
        return str(os.getuid())
