"""The larger mechanism with play, sag and lag, and a load put on while it runs (section 4 of the source work, S4.1)."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, NonNegativeFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError, SpecError
from labrun.models import Stepper, kernel
from labrun_plugins.simulated.bench import Bench, BenchSettings, model_beside

_SCALE = Scale(coordinate=0.05, rate=1.0, acceleration=10.0, force=0.03, signal=0.4, time_s=0.5)
_STOP_RAD = math.radians(80.0)
_GRAVITY = 9.81
_WANDER = 0.3
_WANDER_HZ = 0.3
_MOST_G = 500.0
_MOUNTED = ("load_g", "moving", "load_from_s", "load_to_s")
_SERVOS = ("servo_1", "servo_2")
_ANGLES = ("theta_1", "theta_2")


class SpmLoadSettings(BenchSettings):
    """What the mechanism has that its kinematics do not know, and its load.

    Attributes
    ----------
    play_deg
        Of each horn, to either side; friction holds the horn where it is left.
    offset_deg
        How far the end-effector stands askew because the horns do, unloaded, at small angles.
    load_g, moving, load_from_s, load_to_s
        The load; whether it moves inside its container (then its pull wanders by 30 % at 0.3 Hz); from when to when in
        a trial it hangs there. Conditions of these names change them.
    """

    play_deg: NonNegativeFloat = 1.6
    offset_deg: tuple[float, float] = (8.0, -8.0)
    load_g: float = Field(default=0.0, ge=0.0, le=_MOST_G)
    moving: float = 0.0
    load_from_s: float = 0.0
    load_to_s: float = 1e6


class SpmLoad(Bench):
    """A two-axis spherical mechanism of laminate that bends under its own weight and under what hangs on it.

    Between a servo and the end-effector: the horn sits askew and has play, friction holds it within that play, then the
    laminate, see ``loaded.toml``. The source gives none of these numbers; they are chosen. With `as_modelled` horns
    have neither play nor offset.

    Signals: ``effector_x`` ... ``effector_qw``, pose of the end-effector (at the centre of rotation; orientation
    ``Ry(theta_2) Rx(-phi)``, ``tan phi = tan theta_1 / cos theta_2``); ``theta_1``, ``theta_2``, its angles, and
    ``servo_1``, ``servo_2``, those of the servos (rad); ``load``, what hangs on it (kg).
    """

    Settings: ClassVar[type[BenchSettings]] = SpmLoadSettings
    step_s = 0.001
    scale = _SCALE
    joints = _SERVOS
    sensed = _ANGLES
    remembered = ("mounted", "start_s", "phase", "horn", "inputs_before", "servo", "sight", "stepper")
    signals: Mapping[str, str] = {
        **{
            f"effector_{axis}": "m" if axis in "xyz" else "1"
            for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")
        },
        **dict.fromkeys((*_ANGLES, *_SERVOS), "rad"),
        "load": "kg",
    }

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(model_beside(__file__, "loaded.toml"))
        self._servo, self._sight = self._passage(_SERVOS), self._passage(_ANGLES)
        in_model = self._inside()
        self._hidden = [*in_model, *self._servo.effects, *self._sight.effects]
        self._stepper = Stepper(self._model, effects=in_model, step_s=self.step_s)
        plain = self._settings.as_modelled
        self._play = 0.0 if plain else math.radians(self._settings.play_deg)
        values = self._model.named_values
        held = 1.0 - values["gravity_torque"] / values["stiffness"]
        self._offset = np.zeros(2) if plain else held * np.radians(self._settings.offset_deg)
        self._horn = self._offset.copy()
        self._inputs_before = np.array([[*self._horn, 0.0, 1.0, 1.0]])
        self._phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        self._start_s: float | None = None
        self._mounted = {name: float(getattr(self._settings, name)) for name in _MOUNTED}

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Have the load at hand that the condition says; one that hangs there from the start is put on now."""
        wanted = {name: float(condition.get(name, value)) for name, value in self._mounted.items()}
        if not 0.0 <= wanted["load_g"] <= _MOST_G:
            raise SpecError(
                f"load_g = {wanted['load_g']:g} is not to be had on this bench", hint=f"0 to {_MOST_G:g} g"
            )
        self._mounted, self._start_s = wanted, None

    def begin(self, start_s: float) -> None:
        """Count the load's times from the beginning of a recording."""
        self._start_s = start_s

    def truth(self) -> dict[str, Any]:
        """Return what is mounted, parameters as they are on the bench, and hidden effects."""
        offset_deg = np.degrees(self._offset).tolist()
        return self._truth(
            self._hidden,
            mounted=dict(self._mounted),
            play_deg=math.degrees(self._play),
            offset_deg=offset_deg,
        )

    def _advance(self, time_s: FloatArray) -> FloatArray:
        servos = self._servo(np.column_stack([self._drives[joint].angles(time_s) for joint in self.joints]))
        horns = _with_play(servos + self._offset, self._horn, self._play)
        load_kg = self._load(time_s)
        pulls = np.ones((len(time_s), 2))
        if self._mounted["moving"] and self._settings.noise:
            turn = 2.0 * math.pi * _WANDER_HZ * time_s[:, None] * np.array([1.0, 0.83]) + self._phase
            pulls += _WANDER * np.sin(turn)
        inputs = np.column_stack([horns, load_kg, pulls])
        true = self._stepper.advance(np.concatenate([self._inputs_before, inputs]))
        self._inputs_before = inputs[-1:].copy()
        if not self._stepper.finite or not np.abs(true).max() < _STOP_RAD:
            raise ExperimentError(
                "the simulated mechanism toppled over: its end-effector passed 80 deg",
                hint="a smaller path, a lighter load, or a weaker hidden effect",
            )
        seen = self._sight(true)
        return np.column_stack([_poses(seen), seen, servos, load_kg])

    def _load(self, time_s: FloatArray) -> FloatArray:
        """Return what hangs on the end-effector at these times, kg."""
        begin_s, end_s, kg = (
            self._mounted["load_from_s"],
            self._mounted["load_to_s"],
            1e-3 * self._mounted["load_g"],
        )
        since_s = np.zeros(len(time_s)) if self._start_s is None else time_s - self._start_s
        return np.where((since_s >= begin_s) & (since_s < end_s), kg, 0.0)


@kernel
def _orientation(theta_1: float, theta_2: float) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of the end-effector."""
    phi = -math.atan2(math.tan(theta_1), math.cos(theta_2))
    cy, sy, cx, sx = math.cos(theta_2 / 2), math.sin(theta_2 / 2), math.cos(phi / 2), math.sin(phi / 2)
    return cy * sx, sy * cx, -sy * sx, cy * cx


@kernel
def _with_play(shafts: FloatArray, horn: FloatArray, half_gap: float) -> FloatArray:
    """Return horns that shafts take along once the play is used up, shape (n, 2); `horn` is where they are left."""
    torques = np.empty_like(shafts)
    for i in range(len(shafts)):
        for axis in range(2):
            horn[axis] = min(max(horn[axis], shafts[i, axis] - half_gap), shafts[i, axis] + half_gap)
            torques[i, axis] = horn[axis]
    return torques


@kernel
def _poses(angles: FloatArray) -> FloatArray:
    """Return x, y, z (0) and the quaternion x, y, z, w of the end-effector, shape (n, 7)."""
    poses = np.zeros((len(angles), 7))
    for i in range(len(angles)):
        poses[i, 3], poses[i, 4], poses[i, 5], poses[i, 6] = _orientation(angles[i, 0], angles[i, 1])
    return poses
