"""A fish with one tail fin, held by a bar in a small tank (section 5 of the source work)."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects.quantities import Scale
from labrun.errors import ExperimentError
from labrun.models.stepper import Stepper
from labrun_plugins.simulated.scenes.bench import Bench
from labrun_plugins.simulated.scenes.caudal_model import (
    AMPLITUDE_DEAD_S,
    ANGLE_DEAD_S,
    ECHO_S,
    TIP_LAG_S,
    caudal_model,
)
from labrun_plugins.simulated.scenes.delays import DelayLine
from labrun_plugins.simulated.scenes.hidden import described, hidden_effects
from labrun_plugins.simulated.scenes.servo_model import joint_stepper
from labrun_plugins.simulated.scenes.settings import BenchSettings

_SCALE = Scale(coordinate=1.0, rate=0.5, acceleration=5.0, force=0.3, signal=0.5, time_s=0.2)


class CaudalTankSettings(BenchSettings):
    """`bar_length_m`: the fish hangs this far below the sensor, which so feels torque = force x bar length."""

    bar_length_m: PositiveFloat = 0.4


class CaudalTank(Bench):
    """Thrust of a flapping tail over offset, amplitude and frequency.

    Physics and sources: see `caudal_model`.

    A gait's mean thrust grows with its amplitude by 0.00912 N/deg at 1.4 Hz; off that frequency the waves
    that come back from the walls of the 0.305 m tank turn the thrust round. A trial leaves sloshing waves
    (time constant about 3 s), a returning current (4 s) and random vortices (3 s) behind, which the next
    trial feels unless it waits.

    Signals: ``force_x`` (forward), ``force_y`` (side), ``force_z`` and the torques about the sensor (the fish
    hangs `bar_length_m` below it: torque_x = bar * force_y, torque_y = -bar * force_x), and ``tail``, the
    servo's angle (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = CaudalTankSettings
    step_s = 0.005
    joints = ("tail",)
    signals: Mapping[str, str] = {
        "force_x": "N", "force_y": "N", "force_z": "N", "torque_x": "N m", "torque_y": "N m", "torque_z": "N m",
        "tail": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(caudal_model())
        self._servo = joint_stepper(self.joints, self.step_s)
        on_joints = [one for one in self._settings.hide if one.site in self.joints]
        in_water = [one for one in self._settings.hide if one.site not in self.joints]
        hidden_joints = hidden_effects(on_joints, self._servo.model, _SCALE)
        self._hidden = hidden_effects(in_water, self._model, _SCALE) + hidden_joints
        if hidden_joints:
            self._servo = joint_stepper(self.joints, self.step_s, hidden_joints)
        water = [effect for effect in self._hidden if effect not in hidden_joints]
        self._stepper = Stepper(self._model, effects=water, step_s=self.step_s)
        self._tip_rad = 0.0
        self._servo_rad = 0.0
        self._late = DelayLine(self._steps(AMPLITUDE_DEAD_S + ECHO_S) + 2)
        self._angle = DelayLine(self._steps(ANGLE_DEAD_S) + 2)
        self._joint_before = np.zeros(1)
        self._inputs_before = np.zeros((1, 7))

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects."""
        return {
            "parameters": dict(
                zip((one.name for one in self._model.parameters), self._model.values.tolist(), strict=True)
            ),
            "parameter_errors": dict(self._settings.parameters),
            "bar_length_m": self._settings.bar_length_m,
            "hidden": [described(effect) for effect in self._hidden],
        }

    def _steps(self, duration_s: float) -> int:
        return round(duration_s / self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        commanded = self._drives["tail"].angles(time_s)
        servo = self._servo.advance(np.append(self._joint_before, commanded)[:, None])[:, 0]
        self._joint_before = commanded[-1:].copy()
        tip = self._tip(servo)
        rate = (servo - tip) / TIP_LAG_S
        late = self._late.after(rate, self._steps(AMPLITUDE_DEAD_S), self._steps(AMPLITUDE_DEAD_S + ECHO_S))
        (late_angle,) = self._angle.after(servo, self._steps(ANGLE_DEAD_S))
        noise = self._settings.noise / math.sqrt(self.step_s) * self._rng.standard_normal((len(time_s), 2))
        inputs = np.column_stack([tip, rate, *late, late_angle, noise])
        force = self._stepper.advance(np.concatenate([self._inputs_before, inputs]))
        self._inputs_before = inputs[-1:].copy()
        if not self._stepper.finite:
            raise ExperimentError("the simulated caudal tank blew up", hint="hide a weaker effect, or none")
        forward, side, zero = force[:, 0], force[:, 1], np.zeros(len(time_s))
        bar = self._settings.bar_length_m
        return np.column_stack([forward, side, zero, bar * side, -bar * forward, zero, servo])

    def _tip(self, servo: FloatArray) -> FloatArray:
        """Return the tip's angle: the servo's, behind by a first-order lag."""
        from scipy.signal import lfilter

        # Exact for a servo angle that goes straight from one grid point to the next.
        decay = math.exp(-self.step_s / TIP_LAG_S)
        ramp = TIP_LAG_S / self.step_s * (1.0 - decay)
        before = (ramp - decay) * self._servo_rad + decay * self._tip_rad
        tip, _ = lfilter([1.0 - ramp, ramp - decay], [1.0, -decay], servo, zi=[before])
        self._servo_rad = float(servo[-1])
        self._tip_rad = float(tip[-1])
        return np.asarray(tip)

    def _memory(self) -> dict[str, Any]:
        return {
            "tip_rad": self._tip_rad,
            "servo_rad": self._servo_rad,
            "late": self._late.snapshot(),
            "angle": self._angle.snapshot(),
            "joint_before": self._joint_before.tolist(),
            "inputs_before": self._inputs_before.tolist(),
            "servo": self._servo.snapshot(),
            "stepper": self._stepper.snapshot(),
        }

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._tip_rad = float(memory["tip_rad"])
        self._servo_rad = float(memory["servo_rad"])
        self._late.restore(memory["late"])
        self._angle.restore(memory["angle"])
        self._joint_before = np.array(memory["joint_before"])
        self._inputs_before = np.array(memory["inputs_before"])
        self._servo.restore(memory["servo"])
        self._stepper.restore(memory["stepper"])
