"""An ATI force/torque sensor whose six gauge voltages come from a data acquisition card."""

from typing import Any, ClassVar

from labrun.devices import (
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    Listener,
    Remark,
    SampleBuffer,
    Samples,
    listened,
)  # fmt: skip
from labrun_plugins.ati_daq import calibration, examination
from labrun_plugins.ati_daq.nidaqmx_reader import NidaqmxReader
from labrun_plugins.ati_daq.reader import Card, VoltageReader
from labrun_plugins.ati_daq.reception import Reception
from labrun_plugins.ati_daq.settings import AtiDaqSettings
from labrun_plugins.ati_daq.socket_reader import SocketReader
from labrun_plugins.ati_netft.reception import CHANNELS

_NEAR_END = 0.9
_LISTEN_S = 1.0


class AtiDaq:
    """Six axes, N and N m: load = M (V - V_bias), with M from the sensor's calibration file.

    The device time is the card's count of samples by its true rate. M and V_bias are part of the identity, so that the
    voltages can be had back; nothing else is taken off here: the runner's tare is stored beside the raw data.
    """

    Settings: ClassVar[type[DeviceSettings]] = AtiDaqSettings

    def __init__(self, name: str, settings: AtiDaqSettings, context: DeviceContext) -> None:
        self.name = name
        self.channels = CHANNELS
        self.rate_hz = settings.rate_hz
        self.settings = settings
        self.clock = context.clock
        make = SocketReader if settings.reader == "socket" else NidaqmxReader
        self._reader: VoltageReader = make(name, context.clock, settings)
        self._card: Card | None = None
        self._calibration: calibration.Calibration | None = None
        self._buffer = SampleBuffer(len(CHANNELS))
        self._reception: Reception | None = None
        self._listener: Listener | None = None

    @property
    def calibration(self) -> calibration.Calibration:
        """The sensor's; DeviceError before `open`."""
        if self._calibration is None:
            raise DeviceError(self.name, "is not open", hint="open() comes before any other call")
        return self._calibration

    @property
    def reception(self) -> Reception | None:
        """The stream that runs; None if none does."""
        return self._reception

    def open(self) -> None:
        """Read the calibration file and connect to the card.

        Raises
        ------
        DeviceError
            The file cannot be used, NI's driver or library is missing, or the card does not answer.
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
        style = read.told.get("BodyStyle") or read.told.get("Family") or "force/torque sensor"
        return Identity(
            model=f"ATI {style}",
            serial=read.serial,
            firmware=card.firmware,
            details={
                **read.told,
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
        reception, listener = self._reception, self._listener
        if reception is None or listener is None:
            return Health(notes=("does not sample",))
        listener.check()
        notes = [f"{reception.received} samples at {reception.rate_hz():.5g} Hz, {reception.lost} lost"]
        if reception.saturated:
            notes.append(f"{reception.saturated} samples at the end of the range")
        peak, reception.peak = reception.peak, reception.peak * 0.0
        notes += [
            f"{channel.name} has reached {100 * share:.0f} % of its range"
            for channel, share in zip(CHANNELS, peak, strict=True)
            if share > _NEAR_END
        ]
        return Health(notes=tuple(notes))

    def start(self) -> None:
        """Begin to sample; samples from before are dropped.

        Raises
        ------
        DeviceError
            Not open, or the card refuses.
        """
        read = self.calibration
        self.stop()
        self._buffer.clear()
        self.rate_hz = self._reader.start(self.settings.rate_hz)
        reception = Reception(
            self.name, self.clock, self.settings, self._reader, read, self.rate_hz, self._buffer
        )
        self._reception = reception
        self._listener = Listener(self.name, reception.receive)
        self._listener.start()

    def read(self) -> Samples:
        """Return all samples since the last call; does not wait.

        Raises
        ------
        DeviceError
            Not started; or, once everything that came has been handed over, the stream is lost.
        """
        if self._listener is None:
            raise DeviceError(self.name, "is not streaming", hint="start() comes before read()")
        return self._listener.deliver(self._buffer)

    def stop(self) -> None:
        """End sampling; harmless if it does not."""
        listener, self._listener, self._reception = self._listener, None, None
        if listener is not None:
            listener.stop()
            self._reader.stop()

    def safe_stop(self) -> None:
        """Do nothing: a sensor moves nothing, and its data are wanted to the end."""

    def close(self) -> None:
        """End sampling and disconnect; harmless when not connected."""
        self.stop()
        self._reader.close()
        self._calibration = self._card = None

    def examine(self) -> list[Remark]:
        """Say what there is to say about the set-up; samples for a second if it does not yet."""
        with listened(self, self.clock, _LISTEN_S, streams=self._reception is not None):
            reception = self._reception
        assert reception is not None  # noqa: S101  it ran
        return examination.examine(reception, self.calibration, self.settings, self.rate_hz)


def _numbers(values: Any) -> str:
    """Return numbers, or rows of them, as JSON with ten digits."""
    if isinstance(values, float):
        return f"{values:.10g}"
    return f"[{', '.join(_numbers(value) for value in values)}]"
