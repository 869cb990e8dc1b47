"""From records to samples: order, status, unit, rate, range. `receive` is for a thread of its own.

Order of the records: lost, repeated and overtaken ones, counters that wrap, a stream that begins anew.

`rdt_sequence` numbers the records of one output stream from its start command on; `ft_sequence` counts the box's own
samples and does not care about streams. Both wrap at 2**32.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.devices import SIX_AXES, Clock, DeviceError, FloatArray, Limits, SampleBuffer
from labrun.errors import LimitExceededError
from labrun_plugins.ati_netft import codec
from labrun_plugins.ati_netft.codec import RECORD, Records
from labrun_plugins.ati_netft.network import BoxInfo
from labrun_plugins.ati_netft.settings import BOX_RATE_HZ, AtiNetFtSettings, full_scale
from labrun_plugins.ati_netft.source import Source

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
        """Tell whether nothing but old records comes: the box itself was restarted."""
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


_LOOK_EVERY_S = 0.008
"""The kernel stamps what comes: looking more often would only cost computing time."""
_GRACE_S = 0.5
"""How long the first datagram may take after the start."""
_REORDERED_S = 0.02
_STUCK = 70
_LEAST_PERIODS = 5.0


class Reception:
    """Takes the records of one stream and puts samples into a buffer.

    Parameters
    ----------
    decimation
        Every how many-th record is handed over. All of them are checked.
    """

    def __init__(
        self, device: str, clock: Clock, settings: AtiNetFtSettings,
        source: Source, info: BoxInfo, decimation: int, buffer: SampleBuffer,
    ) -> None:  # fmt: skip
        self._device = device
        self._clock = clock
        self._source = source
        self._info = info
        self._decimation = decimation
        self._buffer = buffer
        self._limits: Limits = settings.limits
        bounds = {"N": settings.limits.force_n, "N m": settings.limits.torque_n_m}
        self._bound = np.array([bounds[channel.unit] or np.inf for channel in SIX_AXES])
        self._full_scale = np.array(full_scale(settings.calibration))
        together = info.buffer_size if settings.mode == "buffered" else 1
        patience = max(2, round(_REORDERED_S * info.rate_hz)) + 2 * together
        self.sequencer = Sequencer(round(BOX_RATE_HZ / info.rate_hz), patience)
        self._silence_s = max(1e-3 * settings.silence_ms, _LEAST_PERIODS * together / info.rate_hz)
        self._heard_s = clock.now() + _GRACE_S
        self._next_slot = 0
        self._stuck = 0
        self._last_ft = -1
        self.halted = False
        """Set when someone has asked for the end of the stream: silence is no fault from then on."""
        self.saturated = 0
        self.conditions = 0
        self.last_status = 0
        self.peak = np.zeros(len(SIX_AXES))
        """Greatest share of its range each axis has felt since someone set this back to zero."""
        self.first_s: float | None = None
        self.last_s = 0.0

    def receive(self) -> None:
        """Wait a moment, and take what has arrived.

        Raises
        ------
        DeviceError
            Nothing comes any more, the box reports an error, or it was restarted.
        LimitExceededError
            A record, also one that is not handed over, is beyond the limits of the file.
        """
        self._clock.sleep(_LOOK_EVERY_S)
        looked_s = self._clock.now()
        try:
            records, host_s = self._source.take()
        except DeviceError:
            self.settle()  # what waited for missing records has arrived, whatever became of the box since
            raise
        if not len(records):
            self._check_silence(looked_s)
            return
        self._heard_s = max(self._heard_s, float(host_s[-1]))
        for block in self.sequencer.feed(records, host_s):
            self._put(block)
        if self.sequencer.counts_anew:
            raise DeviceError(
                self._device,
                "the box restarted its sample count: it was rebooted, and a zero set in it is lost",
                hint="check its supply; labrun resume starts the stream again",
            )

    def settle(self) -> None:
        """Hand over what still waited for missing records, at the end of the stream."""
        block = self.sequencer.settle()
        if len(block):
            self._put(block)

    def rate_hz(self) -> float:
        """Return the records per second received so far, as the host's clock has it; 0 before the second one."""
        if self.first_s is None or self.last_s <= self.first_s:
            return 0.0
        counts = self.sequencer.counts
        return (counts.received - counts.repeated - 1) / (self.last_s - self.first_s)

    def _put(self, block: Ordered) -> None:
        self.first_s = float(block.host_time_s[0]) if self.first_s is None else self.first_s
        self.last_s = float(block.host_time_s[-1])
        words = codec.status_of(block.records)
        self.last_status = int(words[-1])
        serious = codec.is_serious(words)
        good = ~serious
        saturated = codec.is_saturated(words) & good
        values = self._info.to_si(block.records["counts"])
        if good.any():
            self.peak = np.maximum(self.peak, np.abs(values[good]).max(axis=0) / self._full_scale)
        self.saturated += int(saturated.sum())
        self.conditions += int(((words & codec.CONDITION) != 0).sum())
        # Every n-th by the stream's own numbering, so that a loss does not shift those that follow.
        kept = good & (block.position % self._decimation == 0)
        slot_after = (int(block.position[-1]) // self._decimation) + 1
        lost = slot_after - self._next_slot - int((block.position % self._decimation == 0).sum())
        self._next_slot = slot_after
        # A saturated record between two that are handed over spoils them just as much.
        self._buffer.put(
            block.ft_count[kept] / BOX_RATE_HZ, block.host_time_s[kept], values[kept],
            lost=lost, saturated=int(saturated.sum()),
        )  # fmt: skip
        if serious.any():
            raise DeviceError(
                self._device,
                f"reports an error: {codec.words(int(words[np.argmax(serious)]))}; its samples are discarded",
                hint="see the status on its web page; switch it off and on if it stays, and check the sensor's cable",
            )
        self._check_limits(block.host_time_s, values)
        self._check_stuck(block)

    def _check_limits(self, host_s: FloatArray, values: FloatArray) -> None:
        if bool(np.all(np.abs(values).max(axis=0) <= self._bound)):
            return
        for excess in self._limits.sample_excess(SIX_AXES, host_s, values):
            raise LimitExceededError(
                self._device,
                f"{excess} at {excess.time_s:.3f} s on the run's clock",
                hint="look at the bench before labrun resume, or change the limit in the file",
            )

    def _check_stuck(self, block: Ordered) -> None:
        ft = block.ft_count
        self._stuck = self._stuck + len(ft) if bool((ft == self._last_ft).all()) else 0
        self._last_ft = int(ft[-1])
        if self._stuck >= _STUCK:
            raise DeviceError(
                self._device,
                f"repeats one and the same measurement (ft_sequence stays at {self._last_ft})",
                hint="check the cable between sensor and box, and switch the box off and on",
            )

    def _check_silence(self, looked_s: float) -> None:
        # Only when the socket was empty: datagrams that wait while this thread could not run are not missing.
        quiet_s = looked_s - self._heard_s
        if quiet_s <= self._silence_s or self.halted:
            return
        self.settle()
        malformed = self._source.malformed
        malformed_note = f"; {malformed} datagrams were of a wrong length" if malformed else ""
        raise DeviceError(
            self._device,
            f"no datagram for {1e3 * quiet_s:.0f} ms ({self._info.rate_hz:g} samples/s expected){malformed_note}",
            hint="check its power and network cable, and that no other program reads the box: it sends to one alone",
        )
