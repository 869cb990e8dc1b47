"""An ATI force/torque sensor whose six gauge voltages come from a data acquisition card."""

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from labrun.devices import (
    SIX_AXES,
    Clock,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    ListeningSensor,
    Remark,
    SampleBuffer,
    listened,
    opened,
)
from labrun_plugins.ati_daq import calibration
from labrun_plugins.ati_daq.calibration import Calibration
from labrun_plugins.ati_daq.reader import Card, NidaqmxReader, SocketReader, VoltageReader
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
    rate_hz
        The card's true rate.
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
        self._nominal_hz = rate_hz
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

        Raises DeviceError: nothing comes any more, or voltages that cannot be.
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
                f"the card restarted its sample count: {block.first} after {self._next - 1}",
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
        host_s = np.maximum(now_s - (number[-1] - number) / self._nominal_hz, self._latest_s)
        self._latest_s = float(host_s[-1])
        if self._first is None:
            self._first = (now_s, self._next)
        self._buffer.put(number / self._nominal_hz, host_s, loads, lost=lost, saturated=saturated)

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
                f"no voltages for {1e3 * quiet_s:.0f} ms ({self._nominal_hz:g} samples/s expected)",
                hint="check the card's cable, and that no other program uses it; then labrun resume",
            )


_RATE_TOLERANCE = 0.02
_NEAR_RAIL = 0.9


def examine(
    reception: Reception, calibration: Calibration, settings: AtiDaqSettings, rate_hz: float
) -> list[Remark]:
    """Judge what has been sampled for a while. `rate_hz`: what the card says."""
    return [*_stream(reception, settings, rate_hz), *_calibration(calibration, settings)]


def _stream(reception: Reception, settings: AtiDaqSettings, rate_hz: float) -> Iterator[Remark]:
    measured = reception.rate_hz()
    message = f"{measured:.5g} samples/s, the card says {rate_hz:.5g}"
    advice = "this computer cannot keep up, or the card has another clock: lower rate_hz"
    yield Remark.judged(abs(measured / rate_hz - 1.0) <= _RATE_TOLERANCE, "rate", message, advice)
    message = f"{reception.lost} of {reception.received + reception.lost} samples lost"
    yield Remark.judged(not reception.lost, "losses", message, "lower rate_hz")
    gauge = int(np.argmax(reception.peak_v))
    message = f"the greatest is {reception.peak_v[gauge]:.3g} V, of gauge {gauge + 1}"
    if reception.peak_v[gauge] > _NEAR_RAIL * settings.range_v:
        advice = "unload the sensor; a gauge that stays there is not connected, or the sensor is damaged"
        yield Remark("problem", "voltages", message, advice)
    elif not reception.peak_v.all():
        silent = ", ".join(str(i + 1) for i in np.flatnonzero(reception.peak_v == 0.0))
        yield Remark("problem", "voltages", f"gauge {silent} reads 0 V exactly", "check wiring and `input`")
    else:
        yield Remark("ok", "voltages", message)


def _calibration(calibration: Calibration, settings: AtiDaqSettings) -> Iterator[Remark]:
    attributes = calibration.attributes
    text = ", ".join(
        f"{key} {attributes[key]}"
        for key in ("Serial", "PartNumber", "CalDate", "HWTempComp")
        if key in attributes
    )
    yield Remark("ok", "calibration", text or "the file names no sensor", "compare with the sensor's label")
    output = " ".join(attributes[key] for key in ("OutputMode", "OutputRange") if key in attributes)
    if output:
        advice = f"should fit wiring = {settings.wiring!r} and inputs of +-{settings.range_v:g} V"
        yield Remark("ok", "output", f"the file says: {output}", advice)


_NEAR_END = 0.9
_LISTEN_S = 1.0


class AtiDaq(ListeningSensor):
    """Six axes, N and N m: load = M (V - V_bias), with M from the sensor's calibration file.

    The device time is the card's count of samples by its true rate. M and V_bias are part of the identity, so that the
    voltages can be had back; nothing else is taken off here: the runner's tare is stored beside the raw data.
    """

    Settings: ClassVar[type[DeviceSettings]] = AtiDaqSettings

    def __init__(self, name: str, settings: AtiDaqSettings, context: DeviceContext) -> None:
        super().__init__(name, SIX_AXES, settings.rate_hz, context.clock)
        self.settings = settings
        self.zero_known = any(settings.bias_v)
        make = SocketReader if settings.reader == "socket" else NidaqmxReader
        self._reader: VoltageReader = make(name, context.clock, settings)
        self._card: Card | None = None
        self._calibration: calibration.Calibration | None = None
        self._reception: Reception | None = None

    @property
    def calibration(self) -> calibration.Calibration:
        """The sensor's; DeviceError before `open`."""
        return opened(self.name, self._calibration)

    @property
    def reception(self) -> Reception | None:
        """The stream that runs; None if none does."""
        return self._reception

    def open(self) -> None:
        """Read the calibration file and connect to the card.

        Raises DeviceError: the file cannot be used, NI's driver or library is missing, or the card does not answer.
        """
        self.close()
        path = self.settings.calibration_file
        try:
            read = calibration.read(path)
        except calibration.CalibrationError as error:
            raise DeviceError(
                self.name,
                f"calibration file {path}: {error}",
                hint="calibration_file is the .cal file that came with the sensor; ATI has it by serial number",
            ) from None
        self._card = self._reader.open()
        self._calibration = read

    def identify(self) -> Identity:
        """Return sensor, card and calibration; the matrix is in full, so that voltages can be had back."""
        read, card = self.calibration, self._card or Card("")
        style = read.attributes.get("BodyStyle") or read.attributes.get("Family") or "force/torque sensor"
        return Identity(
            model=f"ATI {style}",
            serial=read.serial,
            firmware=card.firmware,
            details={
                **read.attributes,
                "card": card.model,
                "card_serial": card.serial,
                "input": self.settings.input,
                "wiring": self.settings.wiring,
                "rate_hz": f"{self.rate_hz:.9g}",
                "matrix_si_per_v": _numbers(read.matrix.tolist()),
                "maximum_si": _numbers(read.maximum.tolist()),
                "bias_v": _numbers(self.settings.bias_v),
            },
        )

    def health(self) -> Health:
        """Report on the stream; DeviceError if it is lost."""
        if self._calibration is None:
            return Health(ok=False, notes=("not connected",))
        reception = self._reception
        if reception is None:
            return Health(notes=("does not sample",))
        self._check()
        notes = [f"{reception.received} samples at {reception.rate_hz():.5g} Hz, {reception.lost} lost"]
        if reception.saturated:
            notes.append(f"{reception.saturated} samples at the end of the range")
        peak, reception.peak = reception.peak, reception.peak * 0.0
        notes += [
            f"{channel.name} has reached {100 * share:.0f} % of its range"
            for channel, share in zip(SIX_AXES, peak, strict=True)
            if share > _NEAR_END
        ]
        return Health(notes=tuple(notes))

    def start(self) -> None:
        """Begin to sample; samples from before are dropped. Raises DeviceError: not open, or the card refuses."""
        read = self.calibration
        self.stop()
        self.rate_hz = self._reader.start(self.settings.rate_hz)
        self._reception = Reception(
            self.name, self.clock, self.settings, self._reader, read, self.rate_hz, self._buffer
        )
        self._listen(self._reception.receive)

    def stop(self) -> None:
        """End sampling; harmless if it does not."""
        self._reception = None
        if self._hear_no_more():
            self._reader.stop()

    def close(self) -> None:
        """End sampling and disconnect; harmless when not connected."""
        self.stop()
        self._reader.close()
        self._calibration = self._card = None

    def examine(self) -> list[Remark]:
        """Say what there is to say about the set-up; samples for a second if it does not yet."""
        with listened(self, self.clock, _LISTEN_S, streams=self.streams):
            reception = self._reception
        assert reception is not None  # noqa: S101  it ran
        return examine(reception, self.calibration, self.settings, self.rate_hz)


def _numbers(values: Any) -> str:
    """Return numbers, or rows of them, as JSON with ten digits."""
    if isinstance(values, float):
        return f"{values:.10g}"
    return f"[{', '.join(_numbers(value) for value in values)}]"
