"""A Bosch BNO055 on its serial line, in a fusion mode; and what labrun doctor --hardware learns about it."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from labrun.devices import (
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
from labrun_plugins.bno055 import codec
from labrun_plugins.bno055.chip import Chip, Refused, Silent
from labrun_plugins.bno055.sampling import CHANNELS, Sampling, angles, up_in_body
from labrun_plugins.bno055.settings import OFFSET_BYTES, Bno055Settings

_BAUD = 115_200
_RATE_SHARE = 0.95
_OVERRUN_SHARE = 0.2
_AGREES_RAD = float(np.radians(3.0))
_G_M_S2 = 9.80665
_KNOWN_IDS = bytes((0xA0, 0xFB, 0x32, 0x0F))


def identity(ids: bytes, settings: Bno055Settings | None, offsets: bytes) -> Identity:
    """Return what the run keeps about the chip."""
    details = {"ids": ids[:4].hex(" ").upper(), "boot_loader": f"{ids[6]:02X}"}
    if settings is not None:
        details |= {
            "mode": settings.mode,
            "mounted_on": settings.mounted_on,
            "units": "m/s^2, deg/s, deg, degC in the chip",
            "resolution": "quaternion 2^-14, gyroscope 1/16 deg/s",
            "angles": "from the quaternion: Rz(heading) Rx(roll) Ry(pitch)",
            "calibration_offsets": offsets.hex(" ").upper(),
            "calibration_restored": "yes" if settings.offsets else "no",
        }
    return Identity("Bosch BNO055", firmware=f"{ids[5]:02X}.{ids[4]:02X}", details=details)


def of_identity(ids: bytes) -> Remark:
    """Judge the four ids."""
    known = ids[:4] == _KNOWN_IDS
    message = f"ids {ids[:4].hex(' ').upper()}, firmware {ids[5]:02X}.{ids[4]:02X}"
    message += "" if known else f"; {_KNOWN_IDS.hex(' ').upper()} expected"
    return Remark.judged(known, "identity", message, "one of its sensors may be broken: self-test it")


def of_readings(sampling: Sampling, chip: Chip, now_s: float) -> Iterator[Remark]:
    """Judge what came of the readings so far: their rate, how busy the chip was, whether its numbers agree."""
    due = sampling.readings + sampling.lost
    rate_hz = sampling.readings / max(now_s - sampling.began_s, 1e-9)
    message = f"{rate_hz:.4g} readings a second, {sampling.lost} of {due} lost"
    advice = (
        "set the adapter's latency timer to 1 ms, or choose a smaller rate_hz; the chip makes 100 a second"
    )
    yield Remark.judged(sampling.readings >= _RATE_SHARE * due, "rate", message, advice)
    share = chip.overruns / max(chip.requests, 1)
    busy = f"{chip.overruns} of {chip.requests} requests met a bus over-run"
    advice = "some are normal; so many cost readings: lower rate_hz"
    yield Remark.judged(share <= _OVERRUN_SHARE, "over-runs", busy, advice)
    if sampling.last_block is not None:
        yield from of_numbers(sampling.last_block)


def of_numbers(block: codec.Block) -> Iterator[Remark]:
    """Judge whether quaternion, gravity and the chip's own angles tell the same orientation."""
    q = block.quaternion / np.linalg.norm(block.quaternion)
    gravity = float(np.linalg.norm(block.gravity_m_s2))
    message = f"gravity {gravity:.2f} m/s^2"
    if abs(gravity - _G_M_S2) > 0.5:
        yield Remark("warning", "gravity", f"{message}, 9.81 expected", "switch its supply off and on")
    else:
        off_rad = float(np.arccos(np.clip(block.gravity_m_s2 @ up_in_body(q) / gravity, -1.0, 1.0)))
        text = f"{message}, {np.degrees(off_rad):.1f} deg off the vertical of its quaternion"
        advice = "tip it by hand and watch tilt, roll and pitch: axes may be remapped in this chip"
        yield Remark.judged(off_rad <= _AGREES_RAD, "gravity", text, advice)
    heading, roll, pitch = angles(q)
    off = np.abs(np.angle(np.exp(1j * (block.euler_rad - np.array([heading, roll, pitch])))))
    own = ", ".join(f"{angle:.1f}" for angle in np.degrees(block.euler_rad))
    agree = "agree with its quaternion"
    if off.max() > _AGREES_RAD:
        agree = "have other conventions; labrun uses its quaternion"
    yield Remark("ok", "angles", f"the chip's own heading, roll, pitch ({own} deg) {agree}")


def of_calibration(chip: Chip, settings: Bno055Settings) -> Iterator[Remark]:
    """Judge the calibration, and print it for the experiment file; stops the fusion for a moment."""
    try:
        state = chip.state()
        system, gyro, accelerometer, magnetometer = state.calibration
        levels = (
            f"system {system}, gyroscope {gyro}, accelerometer {accelerometer}, magnetometer {magnetometer}"
        )
        wanting = [gyro, accelerometer] if settings.mode == "imu" else [gyro, accelerometer, magnetometer]
        if min(wanting) < 3:
            yield Remark(
                "warning",
                "calibration",
                f"{levels} (3 is full)",
                "keep it still for a few seconds (gyroscope), lay it on six sides (accelerometer), "
                "and swing it in figures of eight (magnetometer)",
            )
            return
        offsets = chip.read_offsets(settings)
    except Refused as refused:
        yield Remark("problem", "calibration", f"{refused}", "switch its supply off and on, then try again")
        return
    text = offsets.hex(" ").upper()
    same = settings.offset_bytes == offsets
    advice = "" if same else f'to keep it, in the device\'s table: offsets = "{text}"'
    yield Remark("ok", "calibration", levels, advice)


def probe(port: str) -> Identity | None:
    """Ask what is at a port for its chip ids."""
    clock = RealClock()
    line = SerialPort("probe", port, _BAUD)
    try:
        line.open()
        chip = Chip("probe", line, clock, answer_s=0.12)
        try:
            ids = chip.read(codec.IDS, 7)
        except Silent:
            return None
        # it may have taken the request for the rest of one that a program before left unfinished
        except Refused:
            ids = chip.read(codec.IDS, 7)
        return identity(ids, None, bytes(OFFSET_BYTES)) if ids[0] == codec.CHIP_ID else None
    except (DeviceError, Refused):
        return None
    finally:
        line.close()


_SYSTEM_ERROR = 1
_EXAMINED_S = 1.0


class Bno055(ListeningSensor):
    """Orientation and angular velocity, up to 100 times a second.

    Quaternion (body to room) and gyroscope are the chip's; heading, roll, pitch and tilt are worked out from the
    quaternion (`orientation.angles`). It neither stamps nor numbers what it sends: a reading is stamped when its last
    byte came, the device time repeats that, and readings that were due and brought nothing are counted as lost.
    """

    Settings: ClassVar[type[DeviceSettings]] = Bno055Settings

    def __init__(self, name: str, settings: Bno055Settings, context: DeviceContext) -> None:
        super().__init__(name, CHANNELS, settings.rate_hz, context.clock)
        self._settings = settings
        self._port = SerialPort(name, settings.port, settings.baud)
        self._chip: Chip | None = None
        self._ids = b""
        self._offsets = b""
        self._state: codec.State | None = None
        self._sampling: Sampling | None = None

    def open(self) -> None:
        """Connect, wait for the chip to boot if need be, and set it up.

        Raises DeviceError: no such port, no right to use it, held by another program, no answer, another chip, or a
        fusion that does not run.
        """
        self.close()
        self._port.open()
        try:
            chip = Chip(self.name, self._port, self.clock)
            self._ids = chip.wake()
            self._offsets = chip.set_up(self._settings)
            self._state = self._asked_state(chip)
        except BaseException:
            self._port.close()
            raise
        self._chip = chip

    def identify(self) -> Identity:
        """Return what it said at `open`."""
        self._opened()
        return identity(self._ids, self._settings, self._offsets)

    def health(self) -> Health:
        """Report its temperature and its calibration, 0 (none) to 3 (full), two seconds old at most while it measures.

        Raises DeviceError: its readings failed, or it does not answer.
        """
        if self._chip is None:
            return Health(ok=False, notes=("not connected",))
        if self._sampling is None:
            self._state = self._asked_state(self._chip)
        else:
            self._check()
        state, notes = self._state, list(self._notes())
        if state is None:
            return Health(notes=tuple(notes))
        return Health(state.status != _SYSTEM_ERROR, state.temperature_c, tuple(notes))

    def _asked_state(self, chip: Chip) -> codec.State:
        try:
            return chip.state()
        except Refused as refused:
            hint = "check its supply and its cable, then labrun resume"
            raise DeviceError(self.name, str(refused), hint=hint) from refused

    def _notes(self) -> Iterator[str]:
        if self._state is not None:
            system, gyro, accelerometer, magnetometer = self._state.calibration
            yield (
                f"calibration: system {system}, gyroscope {gyro}, accelerometer {accelerometer}, "
                f"magnetometer {magnetometer}"
            )
            if self._state.status == _SYSTEM_ERROR:
                yield f"system error {self._state.error:02X}"
        if self._sampling is not None:
            yield f"{self._sampling.readings} readings, {self._sampling.lost} lost"
            corrections = self._sampling.plausibility.corrections
            if corrections:
                yield f"jumps of its heading that it made itself: {corrections}"

    def start(self) -> None:
        """Begin to measure; samples from before are dropped. A chip that was reset meanwhile is set up again.

        Raises DeviceError: it does not answer, or the port is gone.
        """
        chip = self._opened()
        self.stop()
        if not chip.fuses(self._settings):
            self._ids = chip.wake()
            self._offsets = chip.set_up(self._settings)
        self._sampling = Sampling(
            self.name, chip, self.clock, self._buffer,
            rate_hz=self.rate_hz, jump_rad_s=float(np.radians(self._settings.jump_deg_s)), note_state=self._note_state,
        )  # fmt: skip
        self._listen(self._sampling.receive)

    def stop(self) -> None:
        """End the readings; harmless if there are none. The chip goes on by itself, and keeps its calibration."""
        self._sampling = None
        self._hear_no_more()

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        self.stop()
        self._chip = None
        self._port.close()

    def examine(self) -> list[Remark]:
        """Say what there is to say about the set-up; measures for a second if nobody does."""
        chip = self._opened()
        already = self._sampling is not None
        if not already:
            self.start()
            self.clock.sleep(_EXAMINED_S)
        try:
            remarks = [*self._remarks(chip)]
        finally:
            if not already:
                self.stop()
        if not already:
            remarks += of_calibration(chip, self._settings)
        return remarks

    def _remarks(self, chip: Chip) -> Iterator[Remark]:
        yield of_identity(self._ids)
        if self._sampling is not None:
            yield from of_readings(self._sampling, chip, self.clock.now())

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Look whether a BNO055 is at this port, within half a second; only reads."""
        return probe(port)

    def _note_state(self, state: codec.State) -> None:
        self._state = state

    def _opened(self) -> Chip:
        return opened(self.name, self._chip)
