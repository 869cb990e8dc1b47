"""Requests to one BNO055, one at a time, and its set-up."""

from labrun.devices import Clock, DeviceError, SerialPort
from labrun_plugins.bno055 import codec
from labrun_plugins.bno055.settings import OFFSET_BYTES, Bno055Settings

_TRIES = 6
"""The first one, and five more after a bus over-run: normal now and then, its processor is busy with the fusion."""
_OVERRUN_REST_S = 0.003
_ANSWER_S = 0.15
_BETWEEN_S = 0.02
_BOOT_S = 1.5
"""A chip takes 0.65 s after its supply came on."""
_TO_CONFIG_S = 0.025
_TO_FUSION_S = 0.025
_CRYSTAL_S = 0.03
_FUSION_S = 1.0
_FUSION_RUNS = 5
_WIRING = (
    "check its supply, TX and RX (crossed), and that PS1 is high and PS0 low: that selects the serial line"
)


class Refused(Exception):  # noqa: N818  not every one is an error: the caller may ask again
    """A request that did not bring what was asked for; its message says what it brought, after "the chip"."""


class Silent(Refused):
    """Nothing came at all."""


class Chip:
    """What can be asked of the chip.

    Parameters
    ----------
    port
        Open, and read by nobody else during a request.
    answer_s
        How long an answer may take, s.

    Attributes
    ----------
    requests, overruns
        How many were made, and how many of them the chip was too busy for.
    """

    def __init__(self, device: str, port: SerialPort, clock: Clock, *, answer_s: float = _ANSWER_S) -> None:
        self._device = device
        self._port = port
        self._clock = clock
        self._answer_s = answer_s
        self._owed_s = 0.0
        self.requests = 0
        self.overruns = 0

    def read(self, register: int, count: int, *, within_s: float | None = None) -> bytes:
        """Return `count` bytes from `register` on; `within_s` in place of the usual time for an answer.

        Raises
        ------
        Refused
            No answer, not what was asked for, or a status in place of it.
        DeviceError
            The port is gone.
        """
        answer = self._ask(codec.read_request(register, count), count, within_s or self._answer_s)
        if answer.kind == "data":
            return answer.data
        raise Refused(f"answered a reading of register {register:02X} with: {_told(answer.status)}")

    def write(self, register: int, data: bytes) -> None:
        """Write bytes from `register` on; Refused and DeviceError as of `read`."""
        answer = self._ask(codec.write_request(register, data), None, self._answer_s)
        if answer.status != codec.WRITTEN:
            raise Refused(f"answered a writing of register {register:02X} with: {_told(answer.status)}")

    def _ask(self, request: bytes, count: int | None, within_s: float) -> codec.Answer:
        for attempt in range(_TRIES):
            if attempt:
                self._clock.sleep(_OVERRUN_REST_S)
            self._settle()
            self.requests += 1
            self._port.write(request)
            answer = self._hear(count, within_s)
            if answer.kind != "status" or answer.status != codec.OVERRUN:
                break
            self.overruns += 1
        else:
            raise Refused(f"was too busy to answer {_TRIES} times in a row (bus over-run)")
        if answer.kind == "damaged":
            raise Refused("answered with bytes that do not match the request")
        if answer.kind == "none":
            raise Silent("does not answer")
        return answer

    def _hear(self, count: int | None, within_s: float) -> codec.Answer:
        heard = b""
        begun_s = self._clock.now()
        deadline_s = begun_s + within_s
        while True:
            if more := self._port.read():  # it is being answered: the rest may take as long again
                heard += more
                deadline_s = min(self._clock.now(), begun_s + within_s) + within_s
            answer = codec.answer_to_write(heard) if count is None else codec.answer_to_read(heard, count)
            if answer.kind != "none":
                self._owed_s = within_s if answer.kind == "damaged" else 0.0
                return answer
            if self._clock.now() >= deadline_s:
                self._owed_s = within_s
                return codec.Answer("damaged") if heard else answer

    def _settle(self) -> None:
        """Clear the line: what is still to come of the last answer must not pass for the one to the next request."""
        until_s = self._clock.now() + self._owed_s
        while self._clock.now() < until_s:
            self._port.read()
        self._owed_s = 0.0
        self._port.discard_input()

    # --- what it is and how it is made ready ------------------------------------------------------------------------

    def wake(self) -> bytes:
        """Wait until it answers, and return its four ids, two bytes of firmware, and its boot loader's revision.

        Raises DeviceError: no answer within the time a chip takes to boot, or another chip.
        """
        deadline_s = self._clock.now() + _BOOT_S
        while True:
            try:
                self.write(codec.PAGE, b"\x00")
                ids = self.read(codec.IDS, 7)
            except Refused as refused:
                if self._clock.now() > deadline_s:
                    raise DeviceError(self._device, str(refused), hint=_WIRING) from refused
                ids = b""
            if ids and ids[0] == codec.CHIP_ID:
                return ids
            if ids and self._clock.now() > deadline_s:
                raise DeviceError(
                    self._device,
                    f"the device that answers is not a BNO055: its chip id is {ids[0]:02X}, not {codec.CHIP_ID:02X}",
                    hint="check that this port leads to the IMU; a BNO080 or BMI270 speaks another language",
                )
            self._clock.sleep(_BETWEEN_S)

    def set_up(self, settings: Bno055Settings) -> bytes:
        """Bring it from whatever it did into its fusion mode; return the calibration offsets it works with.

        Raises DeviceError: it refused a step, or its fusion does not run.
        """
        try:
            self.write(codec.MODE, bytes((codec.CONFIG_MODE,)))
            self._clock.sleep(_TO_CONFIG_S)
            self.write(codec.UNITS, bytes((codec.DEGREES,)))
            if settings.external_crystal:
                self.write(codec.TRIGGER, bytes((codec.EXTERNAL_CRYSTAL,)))
                self._clock.sleep(_CRYSTAL_S)
            if settings.offset_bytes is not None:
                self.write(codec.OFFSETS, settings.offset_bytes)
            offsets = self.read(codec.OFFSETS, OFFSET_BYTES)
            self.write(codec.MODE, bytes((codec.FUSION_MODE[settings.mode],)))
            self._clock.sleep(_TO_FUSION_S)
            self._wait_for_fusion()
        except Refused as refused:
            raise DeviceError(
                self._device,
                f"{refused} while it was set up",
                hint="switch its supply off and on; if that does not help, check its wiring",
            ) from refused
        return offsets

    def read_offsets(self, settings: Bno055Settings) -> bytes:
        """Return the calibration as it is now; leaves the fusion for a moment, because it can only be read outside.

        Raises Refused, DeviceError: as of `read`; the fusion may not run then.
        """
        self.write(codec.MODE, bytes((codec.CONFIG_MODE,)))
        self._clock.sleep(_TO_CONFIG_S)
        offsets = self.read(codec.OFFSETS, OFFSET_BYTES)
        self.write(codec.MODE, bytes((codec.FUSION_MODE[settings.mode],)))
        self._clock.sleep(_TO_FUSION_S)
        return offsets

    def fuses(self, settings: Bno055Settings) -> bool:
        """Tell whether it is in the mode it was set up for: a chip whose supply failed is not."""
        try:
            return self.read(codec.MODE, 1)[0] & 0x0F == codec.FUSION_MODE[settings.mode]
        except Refused:
            return False

    def state(self) -> codec.State:
        """Return temperature, calibration and system status; Refused if it does not say."""
        return codec.state(self.read(codec.STATE, codec.STATE_BYTES))

    def _wait_for_fusion(self) -> None:
        deadline_s = self._clock.now() + _FUSION_S
        while True:
            state = self.state()
            if state.status == _FUSION_RUNS:
                return
            if self._clock.now() > deadline_s:
                raise DeviceError(
                    self._device,
                    f"its sensor fusion is not running: system status {state.status}, error {state.error}",
                    hint="switch its supply off and on; an error of 3 or more is a fault of the chip or its set-up",
                )
            self._clock.sleep(_TO_FUSION_S)


def _told(status: int) -> str:
    return f"{status:02X}, {codec.STATUS.get(status, 'no known status')}"
