"""Stand-in for a Bosch BNO055, an inertial measurement unit that works out its own orientation."""

import math
from typing import ClassVar

import numpy as np

from labrun.devices import Channel, DeviceContext, DeviceError, DeviceSettings, FloatArray, Health
from labrun_plugins.bno055.settings import Bno055Settings
from labrun_plugins.simulated.device import SimulatedSettings
from labrun_plugins.simulated.sensor import SimulatedSensor, Timing

_QUATERNION_STEP = 2.0**-14
_ANGLE_STEP_RAD = math.radians(1.0 / 16.0)
_GYRO_STEP_RAD_S = math.radians(1.0 / 16.0)
_GYRO_END_RAD_S = math.radians(2000.0)
_ORIENTATION_SD_RAD = math.radians(0.03)
_LEANING_SD_RAD = math.radians(0.3)
_HEADING_DRIFT_SD_RAD_S = math.radians(1.0) / 60.0
_GYRO_SD_RAD_S = math.radians(0.1)
_GYRO_READY_S = 2.0
_FELT = ("qw", "qx", "qy", "qz", "wx", "wy", "wz")
_CHANNELS = (
    Channel("qw", "1"), Channel("qx", "1"), Channel("qy", "1"), Channel("qz", "1"),
    Channel("heading", "rad"), Channel("roll", "rad"), Channel("pitch", "rad"),
    Channel("gyro_x", "rad/s"), Channel("gyro_y", "rad/s"), Channel("gyro_z", "rad/s"),
    Channel("tilt", "rad"),
)  # fmt: skip


class SimulatedBno055Settings(Bno055Settings, SimulatedSettings):
    """Keys of the IMU, and of every simulated device."""


class SimulatedBno055(SimulatedSensor):
    """A BNO055 over UART in a fusion mode, read at up to 100 Hz.

    Steps are those of the registers: quaternion 2^-14, Euler angles 1/16 deg, gyroscope 1/16 deg/s up to 2000 deg/s.
    It neither stamps nor numbers what it sends. Channels: quaternion (body to room), ``heading`` (0 ... 2 pi), ``roll``
    (within +-pi/2) and ``pitch`` (within +-pi), ``gyro_x`` ... ``gyro_z`` in the body's frame; and ``tilt``, how far
    the body's z axis leans from the vertical, which the host works out from the quaternion.

    Roll is a turn about the body's x axis, pitch about y, heading about z, all right-handed: ``R = Rz(heading)
    Rx(roll) Ry(pitch)``, so that roll and pitch follow from gravity alone, within the ranges of the chip. Signs depend
    on how the chip is mounted and on its settings (axis remap, unit select): on a real bench, tip it by hand and look.

    Chosen: a latency of one fusion period of 10 ms and 2.8 ms of wire, 1 ms more on average (a bus over-run is answered
    at once and read again); one sample in 1000 lost. Noise of 0.03 deg in orientation and 0.1 deg/s in rate; it is
    glued on 0.3 deg askew (standard deviations), which is there all the time, so that what it calls level is not quite.
    In mode "imu" heading drifts by 1 deg/min.
    """

    Settings: ClassVar[type[DeviceSettings]] = SimulatedBno055Settings
    model = "BNO055 (simulated)"

    def __init__(self, name: str, settings: SimulatedBno055Settings, context: DeviceContext) -> None:
        self._mounted_on = settings.mounted_on
        self._mode = settings.mode
        self.feels = tuple(f"{settings.mounted_on}_{part}" for part in _FELT)
        # Drawn once: the same chip stays glued on as it is for the whole run.
        self._askew = 0.5 * _LEANING_SD_RAD * context.rng.standard_normal(3)
        drift = float(context.rng.standard_normal()) * _HEADING_DRIFT_SD_RAD_S
        self._drift_rad_s = drift if settings.mode == "imu" else 0.0
        timing = Timing(latency_s=0.0128, jitter_s=0.001, lost_share=1e-3)
        full_scale = np.array([np.inf] * 7 + [_GYRO_END_RAD_S] * 3 + [np.inf])
        super().__init__(
            name, settings, context,
            channels=_CHANNELS, rate_hz=settings.rate_hz, timing=timing, full_scale=full_scale,
            counts_frames=False, has_clock=False,
        )  # fmt: skip

    def open(self) -> None:
        """Connect. Raises DeviceError: this bench has no such body to mount it on."""
        signals = self.scene.signals
        if not all(signal in signals for signal in self.feels):
            ends = f"_{_FELT[-1]}"
            bodies = sorted(signal.removesuffix(ends) for signal in signals if signal.endswith(ends))
            raise DeviceError(
                self.name,
                f"mounted_on = {self._mounted_on!r}: this bench has no such body for an IMU",
                hint=f"it has {', '.join(bodies) or 'none'}",
            )
        super().open()

    def health(self) -> Health:
        """Report the calibration as the chip does, 0 (none) to 3 (full); the gyroscope takes 2 s at rest."""
        state = super().health()
        if not state.ok:
            return state
        gyro = 3 if self._since_open_s() >= _GYRO_READY_S else 0
        magnetometer = 3 if self._mode == "ndof" else 0
        note = f"calibration: system {gyro}, gyroscope {gyro}, accelerometer 3, magnetometer {magnetometer}"
        return Health(ok=True, notes=(note,))

    def _measure(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        felt = self.scene.observe(self.feels, time_s)
        noise = self._rng.standard_normal((count, 6))
        q = _turned(felt[:, :4], self._askew + 0.5 * _ORIENTATION_SD_RAD * noise[:, :3])
        heading = 0.5 * self._drift_rad_s * time_s
        q = _product(np.column_stack([np.cos(heading), np.zeros((count, 2)), np.sin(heading)]), q)
        values = np.empty((count, len(_CHANNELS)))
        values[:, :4] = np.round(q / _QUATERNION_STEP) * _QUATERNION_STEP
        values[:, 4:7] = _whole_steps(_euler(q), _ANGLE_STEP_RAD)
        values[:, 4] %= 2 * np.pi
        values[:, 7:10] = _whole_steps(felt[:, 4:] + _GYRO_SD_RAD_S * noise[:, 3:], _GYRO_STEP_RAD_S)
        across = np.hypot(values[:, 1], values[:, 2])
        values[:, 10] = 2.0 * np.arctan2(across, np.hypot(values[:, 0], values[:, 3]))
        return values


def _whole_steps(values: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.round(values / step) * step)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return products of quaternions (w, x, y, z), shape (n, 4)."""
    scalar = a[:, :1] * b[:, :1] - np.sum(a[:, 1:] * b[:, 1:], axis=1, keepdims=True)
    vector = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])
    return np.concatenate([scalar, vector], axis=1)


def _turned(q: FloatArray, half_turn: FloatArray) -> FloatArray:
    """Return unit quaternions turned, in the body's frame, by twice the small vector `half_turn` (rad)."""
    turned = _product(q, np.concatenate([np.ones((len(q), 1)), half_turn], axis=1))
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _euler(q: FloatArray) -> FloatArray:
    """Return heading, roll and pitch of ``R = Rz(heading) Rx(roll) Ry(pitch)``, rad, shape (n, 3)."""
    w, x, y, z = q.T
    heading = np.arctan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
    roll = np.arcsin(np.clip(2.0 * (y * z + w * x), -1.0, 1.0))
    pitch = np.arctan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y))
    return np.column_stack([heading, roll, pitch])
