"""A camera on a spherical mechanism, to stay level while its base is moved (section 2 of the source work, S2.4)."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.models import Stepper, kernel
from labrun_plugins.simulated.bench import Bench, BenchSettings, hidden_effects, model_beside, require_finite

BODIES = ("base", "end_effector")
SIGNALS = (
    ("qw", "1"),
    ("qx", "1"),
    ("qy", "1"),
    ("qz", "1"),
    ("wx", "rad/s"),
    ("wy", "rad/s"),
    ("wz", "rad/s"),
    ("tilt", "rad"),
)
"""What is known of each body: orientation in the room, angular velocity in its own frame, lean of its normal."""


@kernel
def orientations(angles: FloatArray, before: FloatArray, step_s: float, farthest_rad: float) -> FloatArray:
    """Return the signals of both bodies, shape (n, 2 * 8).

    The base stands at ``Ry(base_y) Rx(base_x)``, the end-effector turns against it by ``Ry(theta_2) Rx(-phi)``,
    ``tan phi = tan theta_1 / cos theta_2``; see `kinematics`. Compiled, so that the numbers do not depend on how
    many are asked for at once.

    Parameters
    ----------
    angles : (n, 4)
        theta_1, theta_2, base_x, base_y at ascending grid points, rad.
    before : (2, 4)
        Quaternions (w, x, y, z) of the bodies at the grid point before; overwritten with the last ones.
    step_s
        Grid step.
    farthest_rad
        Where the mechanism's links meet their stops.
    """
    rows = np.empty((len(angles), 16))
    body = np.empty((2, 4))
    for i in range(len(angles)):
        theta_1 = min(max(angles[i, 0], -farthest_rad), farthest_rad)
        theta_2 = min(max(angles[i, 1], -farthest_rad), farthest_rad)
        phi = math.atan2(math.tan(theta_1), math.cos(theta_2))
        _y_then_x(angles[i, 3], angles[i, 2], body[0])
        relative = np.empty(4)
        _y_then_x(theta_2, -phi, relative)
        _product(body[0], relative, body[1])
        for k in range(2):
            w, x, y, z = body[k]
            _product(np.array([before[k, 0], -before[k, 1], -before[k, 2], -before[k, 3]]), body[k], relative)
            length = math.sqrt(relative[1] ** 2 + relative[2] ** 2 + relative[3] ** 2)
            rate = 2.0 / step_s
            if length > 1e-12:
                rate *= math.atan2(length, relative[0]) / length
            at = 8 * k
            rows[i, at], rows[i, at + 1], rows[i, at + 2], rows[i, at + 3] = w, x, y, z
            rows[i, at + 4], rows[i, at + 5], rows[i, at + 6] = (
                rate * relative[1], rate * relative[2], rate * relative[3],
            )  # fmt: skip
            across = math.hypot(2.0 * (x * z + w * y), 2.0 * (y * z - w * x))
            rows[i, at + 7] = math.atan2(across, 1.0 - 2.0 * (x * x + y * y))
            before[k, 0], before[k, 1], before[k, 2], before[k, 3] = w, x, y, z
    return rows


@kernel
def _y_then_x(about_y: float, about_x: float, out: FloatArray) -> None:
    """Write the quaternion of ``Ry(about_y) Rx(about_x)``."""
    cy, sy = math.cos(0.5 * about_y), math.sin(0.5 * about_y)
    cx, sx = math.cos(0.5 * about_x), math.sin(0.5 * about_x)
    out[0], out[1], out[2], out[3] = cy * cx, cy * sx, sy * cx, -sy * sx


@kernel
def _product(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write the product of two quaternions (w, x, y, z)."""
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


_STOP_RAD = math.radians(85.0)
_LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]] * len(BODIES))
_SCALE = Scale(coordinate=0.15, rate=1.5, acceleration=50.0, force=0.01, signal=0.15, time_s=0.5)


class SpmStabiliserSettings(BenchSettings):
    """How the base is moved; the source says only that it is done by hand and at random.

    Attributes
    ----------
    base_tilt_deg
        Root mean square of the base's tilt about each of its axes; beyond 15 the mechanism leaves its workspace now and
        then. The setting `noise` multiplies it, too.
    base_bandwidth_hz
        Frequency above which the base hardly moves: half the power at this frequency, and 1/256 of it at twice.
    """

    base_tilt_deg: float = Field(default=6.0, ge=0.0, le=15.0)
    base_bandwidth_hz: PositiveFloat = Field(default=0.5, le=5.0)


class SpmStabiliser(Bench):
    """The two-axis spherical mechanism of `kinematics`, of laminate, on a base that is moved at random.

    Joints ``servo_1`` and ``servo_2`` are the servos; a rising servo_1 turns the end-effector about the base's -x axis,
    a rising servo_2 about +y. Between a servo and the end-effector there is the laminate, with its lag and its sag
    (see ``stabiliser.toml``, where the chosen values stand); the links stop at 85 degrees.

    Signals, for each body (``base``, ``end_effector``): ``<body>_qw`` ... ``_qz``, its orientation in the room (z up;
    body to room), ``<body>_wx`` ... ``_wz``, its angular velocity in its own frame, and ``<body>_tilt``, how far its
    normal leans from the vertical. Besides ``servo_1``, ``servo_2`` (what the servos do), ``theta_1``, ``theta_2``
    (what comes of it) and ``base_x``, ``base_y`` (tilt of the base about its axes), rad.
    """

    Settings: ClassVar[type[BenchSettings]] = SpmStabiliserSettings
    step_s = 0.005
    scale = _SCALE
    joints = ("servo_1", "servo_2")
    remembered = ("servos_before", "bodies", "stepper")
    signals: Mapping[str, str] = {
        **{f"{body}_{signal}": unit for body in BODIES for signal, unit in SIGNALS},
        **dict.fromkeys(("servo_1", "servo_2", "theta_1", "theta_2", "base_x", "base_y"), "rad"),
    }

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        moved = {
            "base_tilt": math.radians(self._settings.base_tilt_deg) * self._settings.noise,
            "base_bandwidth": 2.0 * math.pi * self._settings.base_bandwidth_hz,
        }
        self._model = self._with_errors(model_beside(__file__, "stabiliser.toml").with_values(moved))
        self._hidden = hidden_effects(self._settings.hide, self._model, _SCALE)
        self._stepper = Stepper(self._model, effects=self._hidden, step_s=self.step_s)
        self._servos_before = np.zeros(2)
        self._bodies = _LEVEL.copy()

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects."""
        return self._truth(self._hidden)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        servos = np.empty((count + 1, 2))
        servos[0] = self._servos_before
        for column, joint in enumerate(self.joints):
            servos[1:, column] = self._drives[joint].angles(time_s)
        self._servos_before = servos[-1].copy()
        inputs = np.empty((count, 3, 4))
        inputs[:, 0, :2], inputs[:, 2, :2] = servos[:-1], servos[1:]
        inputs[:, 1, :2] = 0.5 * (servos[:-1] + servos[1:])
        # White noise, held over a step: one number for its start, middle and end.
        inputs[:, :, 2:] = self._rng.standard_normal((count, 1, 2)) / math.sqrt(self.step_s)
        angles = self._stepper.advance(inputs)
        require_finite(self._stepper, "stabiliser")
        rows = np.empty((count, len(self.signals)))
        rows[:, :16] = orientations(angles, self._bodies, self.step_s, _STOP_RAD)
        rows[:, 16:18], rows[:, 18:] = servos[1:], angles
        return rows
