"""Order of the records: lost, repeated and overtaken ones, counters that wrap, a stream that begins anew.

`rdt_sequence` numbers the records of one output stream from its start command on; `ft_sequence` counts the box's own
samples and does not care about streams. Both wrap at 2**32.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray
from labrun_plugins.ati_netft.codec import RECORD, Records

IntArray = NDArray[np.int64]

_WRAP = 1 << 32
_FARTHEST = 14_000
"""A jump ahead by more records than two seconds hold is another numbering, not a loss: the stream would be silent."""
_MOST_AT_ONCE = 4096
_MOST_STALE = 200
"""This many old records in a row are no late ones: the box counts anew."""


@dataclass
class Counts:
    """What happened to the records of a stream so far."""

    received: int = 0
    lost: int = 0
    repeated: int = 0
    overtaken: int = 0
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class Ordered:
    """Records in their order, each once.

    Attributes
    ----------
    records, host_time_s : (n,)
        As they came.
    position : (n,)
        Number within the stream, the lost ones counted too.
    ft_count : (n,)
        `ft_sequence` without its wraps.
    """

    records: Records
    host_time_s: FloatArray
    position: IntArray
    ft_count: IntArray

    def __len__(self) -> int:
        return len(self.records)


class Sequencer:
    """Puts records in order.

    A record that is missing is waited for until `patience` younger ones have come; then it is lost.

    Parameters
    ----------
    step
        By how much `ft_sequence` rises from record to record: 7000 / rate.
    patience
        In records.
    """

    def __init__(self, step: int, patience: int) -> None:
        self.counts = Counts()
        self._step = max(step, 1)
        self._patience = patience
        self._expected: int | None = None
        self._position = 0
        self._newest_ft = 0
        self._stale = 0
        self._leapt = False
        self._waiting = _nothing()

    @property
    def counts_anew(self) -> bool:
        """Whether nothing but old records comes: the box itself was restarted."""
        return self._leapt or self._stale >= _MOST_STALE

    def feed(self, records: Records, host_time_s: FloatArray) -> list[Ordered]:
        """Take records as they came; return those whose turn it is. More than one block if the stream began anew."""
        self.counts.received += len(records)
        blocks = []
        while len(records) and not self._leapt:
            sequence = records["rdt_sequence"][:_MOST_AT_ONCE].astype(np.int64)
            ft = records["ft_sequence"][:_MOST_AT_ONCE].astype(np.int64)
            if self._expected is None:
                self._expected = self._first(sequence, ft)
                self._newest_ft = int(ft[0]) - self._step
            ahead = _signed(sequence - self._expected)
            ft_count = self._newest_ft + _signed(ft - self._newest_ft)
            # Numbers and sample counter rise together; a younger sample with an older number is of a new numbering.
            newest = self._waiting.position.max(initial=self._position - 1) - self._position
            farthest_before = _greatest_before(int(newest), ahead)
            newest_before = _greatest_before(self._newest_ft, ft_count)
            anew = ((ahead <= farthest_before) | (ahead > _FARTHEST)) & (ft_count > newest_before)
            end = int(np.argmax(anew)) if anew.any() else len(sequence)
            if end:
                batch = Ordered(records[:end], host_time_s[:end], ahead[:end], ft_count[:end])
                blocks.append(self._sort(batch))
            if end < len(sequence):
                blocks.append(self.settle())
                self._begin_anew(int(sequence[end]), int(ft_count[end]))
            records, host_time_s = records[end:], host_time_s[end:]
        return [block for block in blocks if len(block)]

    def _first(self, sequence: IntArray, ft: IntArray) -> int:
        """Return the number of the stream's first record: the first one that came may have overtaken it."""
        behind = _signed(sequence - sequence[0])
        older = (behind > -self._patience) & (_signed(ft - ft[0]) <= 0)
        return int(sequence[0] + behind[older].min()) % _WRAP

    def settle(self) -> Ordered:
        """Return the records that were still waiting for others, which are lost."""
        waiting, self._waiting = self._waiting, _nothing()
        return self._pass_on(waiting)

    def _sort(self, batch: Ordered) -> Ordered:
        """Put a batch, whose positions are still relative to the one expected, in order with what waits."""
        assert self._expected is not None  # noqa: S101  set by feed
        base = self._position
        oldest_ft = self._newest_ft - 2 * self._patience * self._step
        fresh = (batch.position >= 0) & (batch.ft_count > oldest_ft)
        self._newest_ft = max(self._newest_ft, int(batch.ft_count.max()))
        self._stale = 0 if fresh.any() else self._stale + len(batch)
        self.counts.repeated += int((~fresh).sum())
        batch = Ordered(batch.records, batch.host_time_s, batch.position + base, batch.ft_count)
        batch = _chosen(batch, fresh)
        if len(self._waiting):
            batch = _joined(self._waiting, batch)
        if (np.diff(batch.position) != 1).any():
            self.counts.overtaken += int((np.diff(batch.position) < 0).sum())
            _, first = np.unique(batch.position, return_index=True)
            self.counts.repeated += len(batch) - len(first)
            batch = _chosen(batch, first)
        if not len(batch):
            return batch
        missing = np.diff(batch.position, prepend=base - 1) - 1
        open_gap = (missing > 0) & (batch.position[-1] - batch.position < self._patience)
        end = int(np.argmax(open_gap)) if open_gap.any() else len(batch)
        self._waiting = _chosen(batch, slice(end, None))
        return self._pass_on(_chosen(batch, slice(0, end)))

    def _pass_on(self, block: Ordered) -> Ordered:
        if len(block):
            after = int(block.position[-1]) + 1
            self.counts.lost += after - self._position - len(block)
            assert self._expected is not None  # noqa: S101  there was a record
            self._expected = (self._expected + after - self._position) % _WRAP
            self._position = after
        return block

    def _begin_anew(self, sequence: int, ft_count: int) -> None:
        self.counts.restarts += 1
        self._expected = sequence
        lost = max((ft_count - self._newest_ft) // self._step - 1, 0)
        if lost > _FARTHEST:
            self._leapt = True
            return
        self.counts.lost += lost
        self._position += lost


def _signed(difference: IntArray) -> IntArray:
    """Return differences of two 32-bit counters as the nearest way round: from -2**31 to 2**31 - 1."""
    return (difference + (_WRAP >> 1)) % _WRAP - (_WRAP >> 1)


def _greatest_before(start: int, values: IntArray) -> IntArray:
    """Return for each value the greatest one before it; `start` for the first."""
    return np.maximum.accumulate(np.concatenate(([start], values[:-1])))


def _nothing() -> Ordered:
    none = np.empty(0, np.int64)
    return Ordered(np.empty(0, RECORD), np.empty(0), none, none)


def _chosen(block: Ordered, which: "IntArray | NDArray[np.bool_] | slice") -> Ordered:
    return Ordered(
        block.records[which], block.host_time_s[which], block.position[which], block.ft_count[which]
    )


def _joined(first: Ordered, second: Ordered) -> Ordered:
    return Ordered(
        np.concatenate((first.records, second.records)),
        np.concatenate((first.host_time_s, second.host_time_s)),
        np.concatenate((first.position, second.position)),
        np.concatenate((first.ft_count, second.ft_count)),
    )
