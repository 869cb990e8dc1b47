"""From voltages to samples: calibration, losses, range. `receive` is for a thread of its own."""

import numpy as np

from labrun.devices import Clock, DeviceError, SampleBuffer
from labrun_plugins.ati_daq.calibration import Calibration
from labrun_plugins.ati_daq.reader import VoltageReader
from labrun_plugins.ati_daq.settings import AtiDaqSettings

_GRACE_S = 0.5
"""How long the first block may take after the start."""
_LEAST_PERIODS = 5.0
_RAIL = 0.999
"""Of the input range: a voltage there is cut off."""
_ABSURD = 2.0


class Reception:
    """Takes the voltages of one stream and puts samples into a buffer.

    Parameters
    ----------
    device, clock, settings
        Of the driver.
    reader
        Gives the voltages.
    calibration
        Of the sensor.
    rate_hz
        The card's true rate.
    buffer
        Gets the samples.
    """

    def __init__(
        self, device: str, clock: Clock, settings: AtiDaqSettings,
        reader: VoltageReader, calibration: Calibration, rate_hz: float, buffer: SampleBuffer,
    ) -> None:  # fmt: skip
        self._device = device
        self._clock = clock
        self._settings = settings
        self._reader = reader
        self._calibration = calibration
        self._told_hz = rate_hz
        self._buffer = buffer
        self._bias_v = np.array(settings.bias_v)
        self._silence_s = max(1e-3 * settings.silence_ms, _LEAST_PERIODS / rate_hz)
        self._heard_s = clock.now() + _GRACE_S
        self._next = 0
        self._latest_s = -np.inf
        self._first: tuple[float, int] | None = None
        self.received = 0
        self.lost = 0
        self.saturated = 0
        self.peak = np.zeros(6)
        """Greatest share of its range each axis has felt since someone set this back to zero."""
        self.peak_v = np.zeros(6)

    def receive(self) -> None:
        """Take the next block, waiting a moment for it.

        Raises
        ------
        DeviceError
            Nothing comes any more, or voltages that cannot be.
        """
        looked_s = self._clock.now()
        block = self._reader.read()
        now_s = self._clock.now()
        count = len(block.values)
        if count == 0:
            self._check_silence(looked_s)
            return
        self._heard_s = max(self._heard_s, now_s)
        self._check_values(block.values)
        if block.first < self._next:
            raise DeviceError(
                self._device,
                f"the card counts its samples anew: {block.first} after {self._next - 1}",
                hint="it was started a second time; see that no other program uses it",
            )
        lost, self._next = block.first - self._next, block.first + count
        loads = self._calibration.load(block.values, self._bias_v)
        self.peak = np.maximum(self.peak, np.abs(loads).max(axis=0) / self._calibration.maximum)
        self.peak_v = np.maximum(self.peak_v, np.abs(block.values).max(axis=0))
        ends = (np.abs(block.values) >= _RAIL * self._settings.range_v).any(axis=1)
        ends |= (np.abs(loads) >= self._calibration.maximum).any(axis=1)
        saturated = int(ends.sum())
        self.received += count
        self.lost += lost
        self.saturated += saturated
        number = block.first + np.arange(count)
        # The card samples by its own clock and hands over blocks: only the last sample of a block came just now.
        host_s = np.maximum(now_s - (number[-1] - number) / self._told_hz, self._latest_s)
        self._latest_s = float(host_s[-1])
        if self._first is None:
            self._first = (now_s, self._next)
        self._buffer.put(number / self._told_hz, host_s, loads, lost=lost, saturated=saturated)

    def rate_hz(self) -> float:
        """Return the samples per second made so far, as the host's clock has it; 0 at the beginning."""
        if self._first is None or self._latest_s <= self._first[0]:
            return 0.0
        return (self._next - self._first[1]) / (self._latest_s - self._first[0])

    def _check_values(self, volts: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> None:
        good = np.abs(volts) <= _ABSURD * self._settings.range_v
        if not good.all():
            row, gauge = (int(i) for i in np.argwhere(~good)[0])
            raise DeviceError(
                self._device,
                f"gauge {gauge + 1} reads {volts[row, gauge]:g} V on an input of +-{self._settings.range_v:g} V",
                hint="check what serves the voltages; this cannot come from the card",
            )

    def _check_silence(self, looked_s: float) -> None:
        quiet_s = looked_s - self._heard_s
        if quiet_s > self._silence_s:
            raise DeviceError(
                self._device,
                f"no voltages for {1e3 * quiet_s:.0f} ms ({self._told_hz:g} samples/s expected)",
                hint="check the card's cable, and that no other program uses it; then labrun resume",
            )
