"""A Robotiq FT300 or FT300-S on its serial line, and what labrun doctor --hardware learns about it."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

from labrun.devices import (
    SIX_AXES,
    DeviceContext,
    DeviceError,
    DeviceSettings,
    Health,
    Identity,
    ListeningSensor,
    Remark,
    SerialPort,
    opened,
)
from labrun.devices.clock import RealClock
from labrun_plugins.robotiq_ft300 import codec
from labrun_plugins.robotiq_ft300.link import Link, Nameplate
from labrun_plugins.robotiq_ft300.reception import Polling, Reception
from labrun_plugins.robotiq_ft300.settings import RobotiqFt300Settings

_RATE_TOLERANCE = 0.03
_LUMP = 1.3
"""Frames handed over at once, on average: 1 without a latency timer, 1.6 with one of 16 ms."""
_CRC_ERROR_SHARE = 1e-3


def identity(plate: Nameplate, mode: str, *, was_streaming: bool) -> Identity:
    """Return what the run keeps about the sensor."""
    return Identity(
        model=f"Robotiq FT300 ({plate.firmware.partition('-')[0]})",
        serial=plate.serial,
        firmware=plate.firmware,
        details={
            "production_year": str(plate.year),
            "mode": mode,
            "resolution": "0.01 N, 0.001 N m",
            "full_scale": "300 N, 30 N m",
            "zero_offset": "none taken off",
            "was_still_streaming": "yes" if was_streaming else "no",
        },
    )


def of_stream(source: Reception, port: str) -> Iterator[Remark]:
    """Judge what came of the stream so far: its rate, its lumps, its checksums."""
    frames = source.parser.frames
    rate_hz = source.rate_hz()
    message = f"stream of {rate_hz:.4g} Hz ({frames} frames in {source.lumps} portions)"
    timer = f"/sys/bus/usb-serial/devices/{Path(port).name}/latency_timer"
    shorter = f"echo 1 | sudo tee {timer} (a udev rule keeps it)"
    lumpy = source.lumps > 0 and frames > _LUMP * source.lumps
    if frames < 2:
        yield Remark("problem", "rate", "no stream came", "switch its supply off and on, then try again")
    elif abs(rate_hz / codec.STREAM_HZ - 1.0) > _RATE_TOLERANCE:
        yield Remark(
            "problem",
            "rate",
            f"{message}, {codec.STREAM_HZ:g} Hz expected",
            f"62.5 Hz means a latency timer of 16 ms: {shorter}",
        )
    else:
        lumps = ": frames come in lumps, as with a latency timer of 16 ms" if lumpy else ""
        yield Remark.judged(not lumpy, "rate", message + lumps, shorter)
    wrong = source.parser.crc_errors
    if wrong > _CRC_ERROR_SHARE * frames:
        yield Remark(
            "warning",
            "checksums",
            f"{wrong} of {frames + wrong} frames had a wrong one",
            "check ground, shield and termination of the RS-485 cable, and keep it away from motor cables",
        )
    else:
        yield Remark("ok", "checksums", f"{wrong} wrong ones in {frames} frames")


def of_polling(source: Polling) -> Iterator[Remark]:
    """Judge what came of reading the registers so far."""
    message = f"{source.readings} readings of the registers, {source.lost} missed"
    if source.lost > 0.02 * source.readings:
        yield Remark("warning", "rate", message, "choose a smaller poll_hz, or stream = true for 100 Hz")
    else:
        yield Remark("ok", "rate", f"{message}; stream = true gives 100 Hz")


def of_nameplate(plate: Nameplate, jams: int) -> Iterator[Remark]:
    """Tell what it is, and whether it was left streaming."""
    yield Remark("ok", "identity", f"firmware {plate.firmware}, serial {plate.serial}, made in {plate.year}")
    if jams:
        yield Remark(
            "warning",
            "left streaming",
            f"it was still streaming when labrun came; {jams} jam(s) stopped it",
            "harmless; a program before did not end its stream (killed, or unplugged)",
        )


def probe(port: str) -> Identity | None:
    """Ask what is at a port whether it is an FT300 with the settings of delivery; None if it is not.

    Raises DeviceError: pymodbus is not installed: nobody can be asked.
    """
    clock = RealClock()
    settings = RobotiqFt300Settings(port=port)
    line = SerialPort(port, port, settings.baud)
    link = Link(port, line, clock, settings.slave_id, answer_s=0.12, tries=1)
    try:
        line.open()
        streaming = link.streams()
        if streaming is None:
            return None
        if streaming:
            link.jam()
        return identity(link.nameplate(), "not chosen", was_streaming=streaming)
    except DeviceError:
        return None
    finally:
        line.close()


_EXAMINED_S = 1.0


class RobotiqFt300(ListeningSensor):
    """Six axes at 100 samples/s from its own stream, or at `poll_hz` from its registers.

    Forces and torques are those of the sensor, in steps of 0.01 N and 0.001 N m. It has no zeroing register, and
    nothing is taken off here: the runner's tare is stored beside the raw data.

    A frame carries neither a number nor a time. It is stamped when its last byte came, the device time repeats that,
    and lost frames are estimated from the gaps (`GapCounter`).
    """

    Settings: ClassVar[type[DeviceSettings]] = RobotiqFt300Settings

    def __init__(self, name: str, settings: RobotiqFt300Settings, context: DeviceContext) -> None:
        rate_hz = codec.STREAM_HZ if settings.stream else settings.poll_hz
        super().__init__(name, SIX_AXES, rate_hz, context.clock)
        self._settings = settings
        self._port = SerialPort(name, settings.port, settings.baud)
        self._link: Link | None = None
        self._nameplate: Nameplate | None = None
        self._jams_at_open = 0
        self._source: Reception | Polling | None = None

    def open(self) -> None:
        """Connect: stop a stream that still runs, and ask the sensor what it is.

        Raises DeviceError: no such port, no right to use it, held by another program, no answer, or another device
        answers.
        """
        self.close()
        self._port.open()
        try:
            link = Link(self.name, self._port, self.clock, self._settings.slave_id)
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
        return identity(plate, f"{mode}, {self.rate_hz:g} Hz", was_streaming=self._jams_at_open > 0)

    def health(self) -> Health:
        """Report on the stream; ask for the firmware if there is none, to see that it answers.

        Raises DeviceError: the stream is lost, or it does not answer.
        """
        if self._link is None:
            return Health(ok=False, notes=("not connected",))
        source = self._source
        if source is None:
            return Health(notes=(f"firmware {self._link.firmware()}",))
        self._check()
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

        Raises DeviceError: it does not answer, or the port is gone.
        """
        link = self._opened()
        if self._source is not None:
            self.stop()
        if self._settings.stream:
            link.wake()
            link.start_stream()
            self._source = Reception(
                self.name, self._port, self.clock, self._buffer,
                baud=self._settings.baud, silence_s=1e-3 * self._settings.silence_ms,
            )  # fmt: skip
        else:
            self._source = Polling(link.registers, self.clock, self._buffer, self.rate_hz)
        self._listen(self._source.receive)

    def stop(self) -> None:
        """End the stream; harmless if there is none. DeviceError if the port is gone."""
        source, self._source = self._source, None
        if source is None:
            return
        self._hear_no_more()
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
            self.clock.sleep(_EXAMINED_S)
        try:
            return [*self._remarks()]
        finally:
            if not already:
                self.stop()

    def _remarks(self) -> Iterator[Remark]:
        if self._nameplate is not None:
            yield from of_nameplate(self._nameplate, self._jams_at_open)
        if isinstance(self._source, Reception):
            yield from of_stream(self._source, self._settings.port)
        elif isinstance(self._source, Polling):
            yield from of_polling(self._source)

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Look whether a sensor with the settings of delivery is at this port, within half a second."""
        return probe(port)

    def _opened(self) -> Link:
        return opened(self.name, self._link)
