"""What a trial of many cycles has measured so far, a line a cycle: it outlives the process."""

from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices import Samples
from labrun.store import Journal

_HEAD, _CYCLE, _REST = "begun", "cycle", "rest"


class CycleLog:
    """The numbers of each cycle, and the samples of some, as they come.

    A killed process loses the cycle it was in. Of a power cut the same holds where the log is durable.

    Parameters
    ----------
    path
        Its file. One that tells of another condition or mounting is set aside under another name.
    about
        What the trial is: condition, mounting and the like, JSON-ready.
    durable
        Whether each line is on disk before the next cycle; a dry run moves nothing.

    Attributes
    ----------
    values : objective -> (cycles,)
        Of all cycles so far.
    head
        Start and tare of the recording; None before it has begun.
    checkpoint
        What the bench was like after the latest stretch, of a dry run.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], *, durable: bool) -> None:
        self._journal = Journal(path, durable=durable)
        self._about = dict(about)
        self.values: dict[str, array[float]] = {}
        self.head: dict[str, Any] | None = None
        self.checkpoint: dict[str, Any] | None = None
        self._kept: list[dict[str, Any]] = []
        events = self._journal.events() if path.exists() else []
        if events and events[0].get("about") != self._about:
            self._set_aside()
            events = []
        if events:
            self._take(events)

    @property
    def cycles(self) -> int:
        """How many there are."""
        return max((len(values) for values in self.values.values()), default=0)

    def begin(self, started_s: float, tare: Mapping[str, float]) -> None:
        """Say when the recording began, and what was found with nothing moving."""
        self.head = {"started_s": started_s, "tare": dict(tare)}
        self._journal.append(_HEAD, about=self._about, **self.head)

    def append(self, values: Mapping[str, float], samples: Mapping[str, Samples]) -> None:
        """Keep a cycle's numbers, and the samples where there are any."""
        more = {
            name: [block.device_time_s, block.host_time_s, block.values] for name, block in samples.items()
        }
        self._journal.append(_CYCLE, values=dict(values), samples=more)
        self._grow(values)

    def rest(self, checkpoint: Mapping[str, Any]) -> None:
        """Keep what the bench is like between two stretches."""
        self._journal.append(_REST, checkpoint=dict(checkpoint))

    def back_to_rest(self) -> None:
        """Forget the cycles since the latest checkpoint: a simulated bench goes on from there, and repeats them."""
        events = self._journal.events()
        rests = [number for number, event in enumerate(events) if event["event"] == _REST]
        keep = rests[-1] + 1 if rests else 0
        lines = self._journal.text().splitlines(keepends=True)[:keep]
        self._journal.close()
        self._journal.path.write_text("".join(lines), encoding="utf-8")
        self.values, self.head, self.checkpoint, self._kept = {}, None, None, []
        self._take(events[:keep])

    def kept(self) -> list[tuple[str, Samples]]:
        """Return the samples that were kept by an earlier session, by device, in order; once."""
        found = []
        for event in self._kept:
            for name, (device_s, host_s, values) in event.items():
                rows = np.array(values, dtype=float).reshape(len(device_s), -1)
                found.append((name, Samples(np.array(device_s), np.array(host_s), rows)))
        self._kept = []
        return found

    def remove(self) -> None:
        """Remove the file: the trial is stored."""
        self._journal.close()
        path = self._journal.path
        path.unlink(missing_ok=True)
        with suppress(OSError):  # others may be there
            path.parent.rmdir()

    def close(self) -> None:
        """Release the file."""
        self._journal.close()

    def _take(self, events: Sequence[Mapping[str, Any]]) -> None:
        for event in events:
            if event["event"] == _HEAD:
                self.head = {"started_s": event["started_s"], "tare": event["tare"]}
            elif event["event"] == _CYCLE:
                self._grow(event["values"])
                self._kept.append(event["samples"])
            elif event["event"] == _REST:
                self.checkpoint = event["checkpoint"]

    def _grow(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self.values.setdefault(name, array("d")).append(value)

    def _set_aside(self) -> None:
        path = self._journal.path
        number = 1
        while (aside := path.with_name(f"{path.stem}-set-aside-{number}{path.suffix}")).exists():
            number += 1
        path.rename(aside)
