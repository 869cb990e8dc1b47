"""From records to samples: order, status, unit, rate, range. `receive` is for a thread of its own."""

import numpy as np

from labrun.devices import Channel, Clock, DeviceError, FloatArray, Limits, SampleBuffer
from labrun.errors import LimitExceededError
from labrun_plugins.ati_netft import status
from labrun_plugins.ati_netft.box_info import BoxInfo
from labrun_plugins.ati_netft.sequence import Ordered, Sequencer
from labrun_plugins.ati_netft.settings import BOX_RATE_HZ, AtiNetFtSettings, full_scale
from labrun_plugins.ati_netft.source import Source

CHANNELS: tuple[Channel, ...] = (
    Channel("force_x", "N"), Channel("force_y", "N"), Channel("force_z", "N"),
    Channel("torque_x", "N m"), Channel("torque_y", "N m"), Channel("torque_z", "N m"),
)  # fmt: skip

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
    device, clock, settings
        Of the driver.
    source
        Gives the records.
    info
        Units and rate of the box.
    decimation
        Every how many-th record is handed over. All of them are checked.
    buffer
        Gets the samples.
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
        self._bound = np.array([bounds[channel.unit] or np.inf for channel in CHANNELS])
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
        self.peak = np.zeros(len(CHANNELS))
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
                "the box counts its samples anew: it was restarted, and a zero set in it is lost",
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
        words = status.status_of(block.records)
        self.last_status = int(words[-1])
        serious = status.is_serious(words)
        good = ~serious
        saturated = status.is_saturated(words) & good
        values = self._info.to_si(block.records["counts"])
        if good.any():
            self.peak = np.maximum(self.peak, np.abs(values[good]).max(axis=0) / self._full_scale)
        self.saturated += int(saturated.sum())
        self.conditions += int(((words & status.CONDITION) != 0).sum())
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
                f"reports an error: {status.words(int(words[np.argmax(serious)]))}; its samples are discarded",
                hint="see the status on its web page; switch it off and on if it stays, and check the sensor's cable",
            )
        self._check_limits(block.host_time_s, values)
        self._check_stuck(block)

    def _check_limits(self, host_s: FloatArray, values: FloatArray) -> None:
        if bool(np.all(np.abs(values).max(axis=0) <= self._bound)):
            return
        for excess in self._limits.sample_excess(CHANNELS, host_s, values):
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
        found = f"; {malformed} datagrams were of a wrong length" if malformed else ""
        raise DeviceError(
            self._device,
            f"no datagram for {1e3 * quiet_s:.0f} ms ({self._info.rate_hz:g} samples/s expected){found}",
            hint="check its power and network cable, and that no other program reads the box: it sends to one alone",
        )
