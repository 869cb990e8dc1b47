"""A Bosch BNO055 on its serial line, in a fusion mode."""

from collections.abc import Iterator
from contextlib import suppress
from typing import ClassVar

import numpy as np

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
from labrun_plugins.bno055 import codec, examination
from labrun_plugins.bno055.chip import Chip, Refused
from labrun_plugins.bno055.sampling import CHANNELS, Sampling
from labrun_plugins.bno055.settings import Bno055Settings

_SYSTEM_ERROR = 1
_EXAMINED_S = 1.0


class Bno055:
    """Orientation and angular velocity, up to 100 times a second.

    Quaternion (body to room) and gyroscope are the chip's; heading, roll, pitch and tilt are worked out from the
    quaternion (`orientation.angles`). It neither stamps nor numbers what it sends: a reading is stamped when its last
    byte came, the device time repeats that, and readings that were due and brought nothing are counted as lost.
    """

    Settings: ClassVar[type[DeviceSettings]] = Bno055Settings

    def __init__(self, name: str, settings: Bno055Settings, context: DeviceContext) -> None:
        self.name = name
        self.channels = CHANNELS
        self.rate_hz = settings.rate_hz
        self._settings = settings
        self._clock = context.clock
        self._port = SerialPort(name, settings.port, settings.baud)
        self._chip: Chip | None = None
        self._ids = b""
        self._offsets = b""
        self._state: codec.State | None = None
        self._buffer = SampleBuffer(len(CHANNELS))
        self._sampling: Sampling | None = None
        self._listener: Listener | None = None

    def open(self) -> None:
        """Connect, wait for the chip to boot if need be, and set it up.

        Raises
        ------
        DeviceError
            No such port, no right to use it, held by another program, no answer, another chip, or a fusion that does
            not run.
        """
        self.close()
        self._port.open()
        try:
            chip = Chip(self.name, self._port, self._clock)
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
        return examination.identity(self._ids, self._settings, self._offsets)

    def health(self) -> Health:
        """Report its temperature and its calibration, 0 (none) to 3 (full), two seconds old at most while it measures.

        Raises
        ------
        DeviceError
            Its readings failed, or it does not answer.
        """
        if self._chip is None:
            return Health(ok=False, notes=("not connected",))
        if self._sampling is None:
            self._state = self._asked_state(self._chip)
        else:
            self._hearing().check()
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

        Raises
        ------
        DeviceError
            It does not answer, or the port is gone.
        """
        chip = self._opened()
        self.stop()
        if not chip.fuses(self._settings):
            self._ids = chip.wake()
            self._offsets = chip.set_up(self._settings)
        self._buffer.clear()
        self._sampling = Sampling(
            self.name, chip, self._clock, self._buffer,
            rate_hz=self.rate_hz, jump_rad_s=float(np.radians(self._settings.jump_deg_s)), told=self._note_state,
        )  # fmt: skip
        self._listener = Listener(self.name, self._sampling.receive)
        self._listener.start()

    def read(self) -> Samples:
        """Return all samples since the last call; does not wait.

        Raises
        ------
        DeviceError
            Not started; or, once everything that came has been handed over, its readings fail or the port is gone.
        """
        self._opened()
        if self._sampling is None:
            raise DeviceError(self.name, "is not streaming", hint="start() comes before read()")
        return self._hearing().deliver(self._buffer)

    def stop(self) -> None:
        """End the readings; harmless if there are none. The chip goes on by itself, and keeps its calibration."""
        sampling, self._sampling = self._sampling, None
        if sampling is not None:
            self._hearing().stop()

    def safe_stop(self) -> None:
        """Do nothing: it moves nothing, and sends only what it is asked for."""

    def close(self) -> None:
        """Disconnect; harmless when not connected."""
        with suppress(DeviceError):
            self.stop()
        self._chip = None
        self._port.close()

    def examine(self) -> list[Remark]:
        """Say what there is to say about the set-up; measures for a second if nobody does."""
        chip = self._opened()
        already = self._sampling is not None
        if not already:
            self.start()
            self._clock.sleep(_EXAMINED_S)
        try:
            remarks = [*self._remarks(chip)]
        finally:
            if not already:
                self.stop()
        if not already:
            remarks += examination.of_calibration(chip, self._settings)
        return remarks

    def _remarks(self, chip: Chip) -> Iterator[Remark]:
        yield examination.of_identity(self._ids)
        if self._sampling is not None:
            yield from examination.of_readings(self._sampling, chip, self._clock.now())

    @classmethod
    def probe(cls, port: str) -> Identity | None:
        """Look whether a BNO055 is at this port, within half a second; only reads."""
        return examination.probe(port)

    def _note_state(self, state: codec.State) -> None:
        self._state = state

    def _opened(self) -> Chip:
        if self._chip is None:
            raise DeviceError(self.name, "is not open", hint="open() comes before any other call")
        return self._chip

    def _hearing(self) -> Listener:
        assert self._listener is not None  # noqa: S101  made with every sampling
        return self._listener
