"""A Robotiq FT300 or FT300-S on its serial line."""

from collections.abc import Iterator
from contextlib import suppress
from typing import ClassVar

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
    SerialPort,
)
from labrun_plugins.robotiq_ft300 import codec, examination
from labrun_plugins.robotiq_ft300.link import Link, Nameplate
from labrun_plugins.robotiq_ft300.reception import Polling, Reception
from labrun_plugins.robotiq_ft300.settings import RobotiqFt300Settings

_EXAMINED_S = 1.0


class RobotiqFt300:
    """Six axes at 100 samples/s from its own stream, or at `poll_hz` from its registers.

    Forces and torques are those of the sensor, in steps of 0.01 N and 0.001 N m. It has no zeroing register, and
    nothing is taken off here: the runner's tare is stored beside the raw data.

    A frame carries neither a number nor a time. It is stamped when its last byte came, the device time repeats that,
    and lost frames are estimated from the gaps (`GapCounter`).
    """

    Settings: ClassVar[type[DeviceSettings]] = RobotiqFt300Settings

    def __init__(self, name: str, settings: RobotiqFt300Settings, context: DeviceContext) -> None:
        self.name = name
        self.channels = codec.CHANNELS
        self.rate_hz = codec.STREAM_HZ if settings.stream else settings.poll_hz
        self._settings = settings
        self._clock = context.clock
        self._port = SerialPort(name, settings.port, settings.baud)
        self._link: Link | None = None
        self._nameplate: Nameplate | None = None
        self._jams_at_open = 0
        self._buffer = SampleBuffer(len(codec.CHANNELS))
        self._source: Reception | Polling | None = None
        self._listener: Listener | None = None

    def open(self) -> None:
        """Connect: stop a stream that still runs, and ask the sensor what it is.

        Raises
        ------
        DeviceError
            No such port, no right to use it, held by another program, no answer, or another device answers.
        """
        self.close()
        self._port.open()
        try:
            link = Link(self.name, self._port, self._clock, self._settings.slave_id)
            self._jams_at_open = link.wake()
            self._nameplate = self._asked(link)
        except BaseException:
            self._port.close()
            raise
        self._link = link

    def _asked(self, link: Link) -> Nameplate:
        try:
            return link.nameplate()
        except DeviceError:
            # A stream that stalled just while it was listened to looks like a sensor that does not answer.
            link.jam()
            link.wake()
            return link.nameplate()

    def identify(self) -> Identity:
        """Return what it said at `open`: it answers nothing while it streams."""
        self._opened()
        plate = self._nameplate
        assert plate is not None  # noqa: S101  set by open
        mode = "stream" if self._settings.stream else "registers"
        return examination.identity(
            plate, f"{mode}, {self.rate_hz:g} Hz", was_streaming=self._jams_at_open > 0
        )

    def health(self) -> Health:
        """Report on the stream; ask for the firmware if there is none, to see that it answers.

        Raises
        ------
        DeviceError
            The stream is lost, or it does not answer.
        """
        if self._link is None:
            return Health(ok=False, notes=("not connected",))
        source = self._source
        if source is None:
            return Health(notes=(f"firmware {self._link.firmware()}",))
        self._hearing().check()
        if isinstance(source, Polling):
            return Health(notes=(f"{source.readings} readings, {source.lost} missed",))
        parser = source.parser
        note = (
            f"{parser.frames} frames at {source.rate_hz():.4g} Hz, {parser.crc_errors} wrong checksums, "
            f"about {source.lost} frames lost (by time: they carry no number)"
        )
        return Health(notes=(note,))

    def start(self) -> None:
        """Begin to measure; samples from before are dropped.

        Raises
        ------
        DeviceError
            It does not answer, or the port is gone.
        """
        link = self._opened()
        if self._source is not None:
            self.stop()
        self._buffer.clear()
        if self._settings.stream:
            link.wake()
            link.start_stream()
            self._source = Reception(
                self.name, self._port, self._clock, self._buffer,
                baud=self._settings.baud, silence_s=1e-3 * self._settings.silence_ms,
            )  # fmt: skip
        else:
            self._source = Polling(link.registers, self._clock, self._buffer, self.rate_hz)
        self._listener = Listener(self.name, self._source.receive)
        self._listener.start()

    def read(self) -> Samples:
        """Return all samples since the last call; does not wait. None any more after `safe_stop`.

        Raises
        ------
        DeviceError
            Not started; or, once everything that came has been handed over, the stream is lost or the port gone.
        """
        self._opened()
        if self._source is None:
            raise DeviceError(self.name, "is not streaming", hint="start() comes before read()")
        return self._hearing().deliver(self._buffer)

    def stop(self) -> None:
        """End the stream; harmless if there is none. DeviceError if the port is gone."""
        source, self._source = self._source, None
        if source is None:
            return
        self._hearing().stop()
        source.settle()
        if isinstance(source, Reception):
            self._opened().jam()

    def safe_stop(self) -> None:
        """End the stream: nothing of a sensor moves. Any thread, any number of times; never raises."""
        source = self._source
        if isinstance(source, Reception):
            source.ended = True
            with suppress(Exception):  # a port that is gone carries no stream either
                self._port.write(codec.JAM)

    def close(self) -> None:
        """End the stream and disconnect; harmless when not connected."""
        with suppress(DeviceError):
            self.stop()
        self._link = None
        self._port.close()

    def examine(self) -> list[Remark]:
        """Say what there is to say about the set-up; measures for a second if nobody does."""
        self._opened()
        already = self._source is not None
        if not already:
            self.start()
            self._clock.sleep(_EXAMINED_S)
        try:
            return [*self._remarks()]
        finally:
            if not already:
                self.stop()

    def _remarks(self) -> Iterator[Remark]:
        if self._nameplate is not None:
            yield from examination.of_nameplate(self._nameplate, self._jams_at_open)
        if isinstance(self._source, Reception):
            yield from examination.of_stream(self._source, self._settings.port)
        elif isinstance(self._source, Polling):
            yield from examination.of_polling(self._source)

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Look whether a sensor with the settings of delivery is at this port, within half a second."""
        return examination.probe(port)

    def _opened(self) -> Link:
        if self._link is None:
            raise DeviceError(self.name, "is not open", hint="open() comes before any other call")
        return self._link

    def _hearing(self) -> Listener:
        assert self._listener is not None  # noqa: S101  made with every source
        return self._listener
