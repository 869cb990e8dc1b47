"""The serial line of one FT300: getting its attention, asking what it is, switching its stream."""

from dataclasses import dataclass

from labrun.devices import Clock, DeviceError, SerialPort
from labrun_plugins.robotiq_ft300 import codec
from labrun_plugins.robotiq_ft300.registers import Registers

_LISTEN_S = 0.05
"""Five frames of a stream; an adapter with a latency timer of 16 ms hands over something in that time, too."""
_REST_S = 0.15
"""After a jam it needs at least 100 ms."""
_JAMS = 4
_STARTS = 3


@dataclass(frozen=True, slots=True)
class Nameplate:
    """What the sensor says of itself."""

    firmware: str
    serial: str
    year: int


class Link:
    """What can be asked of a sensor that does not stream, and how to make it stream or stop.

    Parameters
    ----------
    device
        Its name in the experiment file.
    port
        Its serial port.
    clock
        All waiting goes through it.
    slave_id
        Its Modbus address.
    answer_s, tries
        As of `Registers`.
    """

    def __init__(
        self,
        device: str,
        port: SerialPort,
        clock: Clock,
        slave_id: int,
        *,
        answer_s: float = 0.25,
        tries: int = 2,
    ) -> None:
        self._device = device
        self._port = port
        self._clock = clock
        self.registers = Registers(device, port, clock, slave_id, answer_s=answer_s, tries=tries)

    def wake(self) -> int:
        """Make sure that it listens: it may still stream from a run before. Returns how many jams it took.

        Raises
        ------
        DeviceError
            Something on this port goes on sending.
        """
        parser = codec.StreamParser()
        for jams in range(_JAMS):
            heard = self._hear(_LISTEN_S)
            if not heard:
                return jams
            parser.feed(heard)
            self.jam()
        if not (heard := self._hear(_LISTEN_S)):
            return _JAMS
        parser.feed(heard)
        if parser.frames:
            raise DeviceError(
                self._device,
                f"goes on streaming after {_JAMS} x {len(codec.JAM)} bytes FF, which should stop it",
                hint="does the line lead to the sensor (A and B, both directions)? switch its supply off and on",
            )
        raise DeviceError(
            self._device,
            f"{self._port.port} sends bytes that are no frames of an FT300",
            hint="check that this port leads to the sensor, and the baud of its table",
        )

    def jam(self) -> None:
        """End the stream, wait until the sensor listens again, and throw away what came meanwhile."""
        self._port.write(codec.JAM)
        self._clock.sleep(_REST_S)
        self._port.discard_input()

    def nameplate(self) -> Nameplate:
        """Ask what it is.

        Raises
        ------
        DeviceError
            No answer, or something answers that is no force/torque sensor.
        """
        firmware = self.firmware()
        serial = codec.serial_text(self.registers.read(codec.SERIAL, 4))
        (year,) = self.registers.read(codec.YEAR, 1)
        return Nameplate(firmware, serial, year)

    def firmware(self) -> str:
        """Ask for its firmware; DeviceError if it is not that of a force/torque sensor."""
        firmware = codec.firmware_text(self.registers.read(codec.FIRMWARE, 3))
        if not codec.is_sensor(firmware):
            raise DeviceError(
                self._device,
                f"what answers is no FT300: its firmware is {firmware}, one of the sensor begins with F",
                hint="a gripper of Robotiq speaks Modbus with slave 9, too: check port and cable",
            )
        return firmware

    def start_stream(self) -> None:
        """Switch the stream on; from now on it answers nothing.

        Raises
        ------
        DeviceError
            It does not stream, whatever it answered.
        """
        for attempt in range(_STARTS):
            try:
                self.registers.write(codec.SELECT_OUTPUT, [codec.STREAM_ON])
                return
            except DeviceError:
                if self.streams():  # only its acknowledgement got lost
                    return
                if attempt == _STARTS - 1:
                    raise

    def streams(self) -> bool | None:
        """Listen whether it streams; None if something else talks here."""
        heard = self._hear(_LISTEN_S)
        if not heard:
            return False
        parser = codec.StreamParser()
        return True if parser.feed(heard) else None

    def _hear(self, duration_s: float) -> bytes:
        heard = b""
        until_s = self._clock.now() + duration_s
        while self._clock.now() < until_s:
            heard += self._port.read()
        return heard
