"""A run that another process executes, perhaps on another machine, as its folder shows it."""

import json
import os
import platform
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labrun.arrays import FloatArray
from labrun.devices import Clock
from labrun.signals import LongSignals
from labrun.store.folder import TrialSource
from labrun.store.journal import JournalTail, stamp_s
from labrun.store.locate import JOURNAL, PACKED, TRIALS
from labrun.store.trial import TrialOutcome
from labrun.store.trial_file import BESIDE, TrialFile

_ENDS = ("finished", "failed", "interrupted", "limit-reached")
_LEAST_SILENCE_S = 15.0
_SILENCE = 3.0
"""A run is silent when it says nothing for so many times the longest pause it has made."""
_RATED_TRIALS = 50
_BETWEEN_LOOKS_S = 2.0


class RunWatch:
    """Follows a run folder by reading its journal again and again; never writes there, never locks.

    Parameters
    ----------
    clock
        Tells how much time passes between two looks.

    Attributes
    ----------
    trials
        By index, as far as the journal tells of them, with later marks applied.
    expected
        Number of trials the run expects in all; None if it cannot know.
    last
        The last event; None before the first.
    ended
        The event that ended the run, if none has followed.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self.folder = folder
        self._clock = clock
        self.tail = JournalTail(folder / JOURNAL)
        self._looked = False
        self._quiet_before_s = 0.0
        self._heard_s = clock.now()
        self._clear()

    def _clear(self) -> None:
        self.trials: dict[int, TrialOutcome] = {}
        self.expected: int | None = None
        self.last: dict[str, Any] | None = None
        self.ended: dict[str, Any] | None = None
        self._prepared: dict[int, dict[str, Any]] = {}
        self._longest_pause_s = 0.0
        self._trial_stamps_s: list[float] = []

    def poll(self) -> bool:
        """Look at the folder; tell whether there was anything new."""
        events, anew = self.tail.read()
        if anew:
            self._clear()
        for event in events:
            # A line from another version, or one that someone edited, may lack anything.
            with suppress(KeyError, TypeError, ValueError, AttributeError):
                self._take(event)
        if events:
            self._heard_s = self._clock.now()
            self._quiet_before_s = 0.0 if self._looked else self._age_at_first_look_s()
        self._looked = True
        return bool(events)

    @property
    def quiet_s(self) -> float:
        """How long ago the last event was, s.

        Between two looks by this machine's monotonic clock alone; before the first look by the file's time and the
        event's stamp, whichever makes less, since the clocks of other machines may be wrong.
        """
        return self._quiet_before_s + self._clock.now() - self._heard_s

    @property
    def is_silent(self) -> bool:
        """Tell whether nothing came for longer than the run has ever paused."""
        return self.quiet_s > max(_LEAST_SILENCE_S, _SILENCE * self._longest_pause_s)

    @property
    def clock_difference_s(self) -> float | None:
        """How far the clock of the folder's machine is ahead of the clock of the one that runs; None if unknown."""
        stamp = None if self.last is None else stamp_s(self.last)
        changed = self.tail.changed_utc_s
        return None if stamp is None or changed is None else changed - stamp

    def dead_process(self) -> int | None:
        """Return the number of the process that ran this, if it ran on this machine and is gone; None if not known."""
        if self.quiet_s < _BETWEEN_LOOKS_S:
            return None
        try:
            note = json.loads((self.folder / ".lock").read_bytes())
            if note["machine"] != platform.node():
                return None
            process = int(note["pid"])
            os.kill(process, 0)
        except ProcessLookupError:
            return process
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return None

    def remaining_s(self) -> float | None:
        """Return the time left by the pace of the last trials; None if nobody can know."""
        stamps = self._trial_stamps_s[-_RATED_TRIALS:]
        if self.expected is None or len(stamps) < 2 or self.ended is not None:
            return None
        each_s = (stamps[-1] - stamps[0]) / (len(stamps) - 1)
        return max(0.0, each_s * (self.expected - len(self.trials)))

    def _age_at_first_look_s(self) -> float:
        now = datetime.now(UTC).timestamp()
        stamp = None if self.last is None else stamp_s(self.last)
        ages = [now - time for time in (stamp, self.tail.changed_utc_s) if time is not None]
        return min((age for age in ages if age >= 0), default=0.0)

    def _take(self, event: dict[str, Any]) -> None:
        kind = event["event"]
        self._note_pause(event)
        self.last = event
        self.ended = event if kind in _ENDS else None
        if kind == "expected":
            self.expected = event["trials"]
        elif kind == "prepare":
            self._take_lost_lines(event["index"])
            self._prepared[event["index"]] = event
        elif kind == "trial":
            self._store(event)
        elif kind == "mark" and event["index"] in self.trials:
            marked = self.trials[event["index"]].marked(event["status"], event["reason"])
            self.trials[event["index"]] = marked
        elif kind == "damaged":
            self.trials.pop(event["index"], None)

    def _note_pause(self, event: dict[str, Any]) -> None:
        if event["event"] == "resumed":
            self._trial_stamps_s = []  # what the pause took says nothing of the pace
            return
        before, now = None if self.last is None else stamp_s(self.last), stamp_s(event)
        if before is not None and now is not None and self.ended is None:
            self._longest_pause_s = max(self._longest_pause_s, now - before)

    def _store(self, event: dict[str, Any]) -> None:
        index = event["index"]
        prepared = self._prepared.pop(index, {})
        stamp = stamp_s(event)
        self.trials[index] = TrialOutcome(
            index,
            prepared.get("condition", {}),
            event["repeat"],
            event["role"],
            event["status"],
            event.get("reason", ""),
            objectives=event.get("objectives", {}),
        )
        if stamp is not None:
            self._trial_stamps_s.append(stamp)

    def _take_lost_lines(self, index: int) -> None:
        """Take up trials whose line a crash kept from the journal: the run has gone on to a later one."""
        for lost in [earlier for earlier in self._prepared if earlier < index]:
            del self._prepared[lost]
            outcome = read_outcome(self.folder / TRIALS, lost)
            if outcome is not None:
                self.trials[lost] = outcome


MOST_SAMPLES = 100_000
"""Of a longer trace the end is read: a night at 7 kHz is gigabytes, which nobody wants to wait for."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One channel of one trial.

    Attributes
    ----------
    channel
        ``device.channel``.
    time_s, values : (n,)
        From the start of the trial; tared, in `unit`.
    whole
        False if only the end of a long recording was read.
    channels
        Every channel of that trial with its unit, by ``device.channel``.
    """

    index: int
    channel: str
    unit: str
    time_s: FloatArray
    values: FloatArray
    whole: bool
    channels: dict[str, str]


def read_trace(folder: Path, index: int, wanted: Sequence[str]) -> Trace | None:
    """Read a trace without locking anything.

    Parameters
    ----------
    wanted
        Channels in order of preference, ``device.channel``; the first that the trial has is taken, and any channel
        where it has none of them. The trace is then of another channel than asked for.

    Returns
    -------
    Trace or None
        None if the trial is not there (any more), or has no samples.
    """
    for path in (folder / TRIALS / f"{index:06d}.h5", folder / PACKED):
        # A file may vanish, or be replaced, between any two steps; HDF5 then fails anywhere, in many ways.
        try:
            source = TrialSource(folder / PACKED, {} if path.name == PACKED else {index: path}, locked=False)
            with closing(source), source.tables(index) as tables:
                return _trace(tables, index, wanted)
        except Exception:  # noqa: S112 - the next look finds the trial where it is then
            continue
    return None


def read_outcome(trials: Path, index: int) -> TrialOutcome | None:
    """Read the outcome of a trial from its file without locking it; None if it cannot be read."""
    try:
        with TrialFile(trials / f"{index:06d}.h5", locked=False) as file:
            return file.outcome
    except Exception:  # as above
        return None


def _trace(tables: Mapping[str, LongSignals], index: int, wanted: Sequence[str]) -> Trace | None:
    channels = {
        f"{name}.{column}": unit
        for name, table in tables.items()
        if name not in BESIDE and len(table)
        for column, unit in zip(table.columns, table.units, strict=True)
    }
    channel = next((name for name in (*wanted, *channels) if name in channels), None)
    if channel is None:
        return None
    device, _, name = channel.partition(".")
    table = tables[device]
    shown = table.last(MOST_SAMPLES).tared().signal(name)
    return Trace(index, channel, shown.unit, shown.time_s, shown.values, len(table) <= MOST_SAMPLES, channels)
