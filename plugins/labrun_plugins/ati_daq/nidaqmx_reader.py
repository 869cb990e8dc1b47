"""Voltages from a card of National Instruments, by way of nidaqmx and NI's own driver."""

from contextlib import suppress
from typing import Any

import numpy as np

from labrun.devices import Clock, DeviceError
from labrun_plugins.ati_daq.reader import Card, Voltages
from labrun_plugins.ati_daq.settings import GAUGES, AtiDaqSettings

_BUFFER_S = 4.0
_NAP_S = 0.005
_OVERWRITTEN = -200279
_GONE = (-88705, -201003, -200220)
_NO_CHANNEL = (-200170, -200220)


class NidaqmxReader:
    """Six analogue inputs with a hardware clock.

    Parameters
    ----------
    device, clock, settings
        Of the driver.
    """

    def __init__(self, device: str, clock: Clock, settings: AtiDaqSettings) -> None:
        self._device = device
        self._clock = clock
        self._settings = settings
        self._task: Any = None
        self._reader: Any = None
        self._next = 0

    def open(self) -> Card:
        """Reserve the inputs."""
        try:
            import nidaqmx
            from nidaqmx.constants import TerminalConfiguration
            from nidaqmx.stream_readers import AnalogMultiChannelReader
        except ImportError:
            raise DeviceError(
                self._device, 'reader = "nidaqmx" needs the library nidaqmx', hint="pip install 'labrun[daq]'"
            ) from None
        wiring = (
            TerminalConfiguration.DIFF
            if self._settings.wiring == "differential"
            else TerminalConfiguration.RSE
        )
        try:
            self._task = nidaqmx.Task()
            self._task.ai_channels.add_ai_voltage_chan(
                self._settings.input,
                terminal_config=wiring,
                min_val=-self._settings.range_v,
                max_val=self._settings.range_v,
            )
            count = len(self._task.ai_channels)
            card = self._task.devices[0] if count else None
            answer = Card(str(card.product_type), f"{card.serial_num:X}") if card is not None else Card("")
            self._reader = AnalogMultiChannelReader(self._task.in_stream)
        except Exception as error:
            self.close()
            raise self._explained(error, nidaqmx) from None
        if count != GAUGES:
            self.close()
            raise DeviceError(
                self._device,
                f"input = {self._settings.input!r} is {count} channels, and the sensor has {GAUGES} gauges",
                hint='for example input = "Dev1/ai0:5"',
            )
        return answer

    def start(self, rate_hz: float) -> float:
        """Begin to sample."""
        import nidaqmx
        from nidaqmx.constants import AcquisitionType

        try:
            self._task.timing.cfg_samp_clk_timing(
                rate_hz,
                sample_mode=AcquisitionType.CONTINUOUS,
                samps_per_chan=max(1000, int(_BUFFER_S * rate_hz)),
            )
            self._next = 0
            self._task.start()
            return float(self._task.timing.samp_clk_rate)
        except Exception as error:
            raise self._explained(error, nidaqmx) from None

    def read(self) -> Voltages:
        """Return what the card has put into its buffer."""
        import nidaqmx

        try:
            count = int(self._task.in_stream.avail_samp_per_chan)
            if count == 0:
                self._clock.sleep(_NAP_S)
                return Voltages(self._next)
            values = np.empty((GAUGES, count))
            self._reader.read_many_sample(values, number_of_samples_per_channel=count, timeout=0.0)
        except Exception as error:
            raise self._explained(error, nidaqmx) from None
        first, self._next = self._next, self._next + count
        return Voltages(first, np.ascontiguousarray(values.T))

    def stop(self) -> None:
        """End sampling."""
        if self._task is not None:
            with suppress(Exception):  # it is over, whatever a card that was unplugged says to that
                self._task.stop()

    def close(self) -> None:
        """Give the inputs back."""
        task, self._task, self._reader = self._task, None, None
        if task is not None:
            with suppress(Exception):
                task.close()

    def _explained(self, error: Exception, nidaqmx: Any) -> DeviceError:
        if isinstance(error, nidaqmx.errors.DaqNotFoundError):
            return DeviceError(
                self._device,
                "the NI-DAQmx driver is not installed (nidaqmx is only its Python face)",
                hint='install it from ni.com/downloads; or serve another card with reader = "socket"',
            )
        code = getattr(error, "error_code", 0)
        text = " ".join(str(error).split())[:200]
        if code == _OVERWRITTEN:
            hint = "this computer was too busy to fetch the samples in time: lower rate_hz"
        elif code in _GONE or code in _NO_CHANNEL:
            hint = f"is the card plugged in? `input` is {self._settings.input!r}; NI MAX lists the cards"
        else:
            hint = f"NI-DAQmx error {code}; NI MAX can test the card"
        return DeviceError(self._device, f"the card says: {text}", hint=hint)
