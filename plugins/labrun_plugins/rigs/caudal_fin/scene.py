"""A fish with one tail fin, held by a bar in a small tank (section 5 of the source work)."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.models import Stepper, kernel
from labrun_plugins.rigs.caudal_fin.fins import BEST_N, Fin, FinSettings, named_fin, thrust_n
from labrun_plugins.simulated.bench import (
    Bench,
    BenchSettings,
    model_beside,
    packed,
    require_finite,
    unpacked,
)

_BEST_HZ = 1.4
"""Frequency at which the returning wave meets the tail in phase (best gait of section 5.2)."""
_ECHO_S = 1.0 / _BEST_HZ
"""Time from a stroke until its wave is back: one period at the best frequency, which makes it the best."""
_TIP_LAG_S = 0.1
"""The flexible sheet's tip follows the servo with this lag (chosen)."""
_SERVO_DELAY_S = 0.05
"""(5.5) and (5.6) count from the command. An RC servo of 6 Hz that takes 50 commands/s is behind by about this."""
_ANGLE_DEAD_S = 0.12 - _SERVO_DELAY_S
"""Dead time of eq. (5.6), less the servo's."""
_AMPLITUDE_DEAD_S = 0.28 - _TIP_LAG_S
"""Dead time of eq. (5.5), less the tip's lag, which acts like a part of it.

The servo's does not come on top: a tail at rest is at half its stroke's speed before the servo has caught up.
"""
QUARTER_S = 0.25 / _BEST_HZ
"""A rate and the one this long before it give the amplitude at any moment of a stroke (best frequency)."""
_SCALE = Scale(coordinate=1.0, rate=0.5, acceleration=5.0, force=0.3, signal=0.5, time_s=2.0)
_NOT_IN_THE_STEP_MODELS = ("echo", "left_over", "bend")
"""Parameters of what (5.5) and (5.6) do not have: what walls and saturation do to a tail off its best gait."""
_OF_THE_FIN = ("thrust_gain", "vortices")
"""Parameters that grow with the thrust of the fin."""


class CaudalTankSettings(FinSettings):
    """The bar, and the fin.

    Attributes
    ----------
    bar_length_m
        The fish hangs this far below the sensor, which so feels torque = force x bar length.
    """

    bar_length_m: PositiveFloat = 0.4


class DelayLine:
    """Remembers the last `length` values of a signal; before the first one it was zero."""

    def __init__(self, length: int) -> None:
        self._past = np.zeros(length)

    def after(self, values: FloatArray, *delays: int) -> tuple[FloatArray, ...]:
        """Take the next values, and return what the signal was `delays` steps before each of them."""
        line = np.concatenate([self._past, values])
        end = len(line)
        count = len(values)
        self._past = line[end - len(self._past) :].copy()
        return tuple(line[end - count - delay : end - delay] for delay in delays)

    def snapshot(self) -> dict[str, Any]:
        """Return the memory as JSON-ready values."""
        return packed(self._past)

    def restore(self, stored: dict[str, Any]) -> None:
        """Take back what `snapshot` gave."""
        self._past = unpacked(stored)


class CaudalTank(Bench):
    """Thrust of a flapping tail over offset, amplitude and frequency.

    Physics and sources: see ``tank.toml``.

    A gait's mean thrust is 0.00912 N/deg times its amplitude at 1.4 Hz, but somewhat more between
    40 and 60 deg (it saturates); off that frequency the waves
    that come back from the walls of the 0.305 m tank turn the thrust round. A trial leaves sloshing waves
    (time constant about 3 s), a returning current (4 s) and random vortices (3 s) behind, which the next
    trial feels unless it waits.

    Another fin pushes and stirs up as much more or less as it does in Table 5.2; its lag is the same (chosen).

    With `as_modelled` no wave comes back and the thrust is straight in amplitude: (5.5), (5.6), what a stroke's own
    momentum does, and vortices.

    Signals: ``force_x`` (forward), ``force_y`` (side), ``force_z`` and the torques about the sensor (the fish
    hangs `bar_length_m` below it: torque_x = bar * force_y, torque_y = -bar * force_x), and ``tail``, the
    servo's angle (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = CaudalTankSettings
    step_s = 0.01
    scale = _SCALE
    joints = ("tail",)
    sensed = ("torque_y", "torque_x")
    remembered = (
        "fin", "tip_rad", "servo_rad", "late", "angle", "momentum", "inputs_before", "servo", "sensor", "stepper",
    )  # fmt: skip
    signals: Mapping[str, str] = {
        "force_x": "N", "force_y": "N", "force_z": "N", "torque_x": "N m", "torque_y": "N m", "torque_z": "N m",
        "tail": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(model_beside(__file__, "tank.toml"))
        if self._settings.as_modelled:
            self._model = self._model.with_values(dict.fromkeys(_NOT_IN_THE_STEP_MODELS, 0.0))
        self._servo, self._sensor = self._passage(self.joints), self._passage(self.sensed)
        self._water = self._inside()
        self._hidden = self._water + self._servo.effects + self._sensor.effects
        self._large = self._model
        self._put((self._settings.material, self._settings.thickness_mm, self._settings.fin))
        self._tip_rad = 0.0
        self._servo_rad = 0.0
        self._late = DelayLine(self._steps(_AMPLITUDE_DEAD_S + _ECHO_S) + 2)
        self._angle = DelayLine(self._steps(_ANGLE_DEAD_S) + 2)
        self._momentum = np.zeros(2)
        self._inputs_before = np.zeros((1, len(self._model.inputs)))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Mount the fin that the condition names by ``material``, ``thickness_mm`` and ``fin``."""
        wanted = named_fin(condition, self._fin)
        if wanted != self._fin:
            state = self._stepper.state
            self._put(wanted)
            self._stepper.state = state

    def truth(self) -> dict[str, Any]:
        """Return the fin, parameters as they are on the bench, and hidden effects."""
        fin = dict(zip(("material", "thickness_mm", "fin"), self._fin, strict=True))
        return self._truth(self._hidden, fin=fin, bar_length_m=self._settings.bar_length_m)

    def _put(self, fin: Fin) -> None:
        share = thrust_n(*fin) / BEST_N
        large = self._large.named_values
        self._fin = fin
        self._model = self._large.with_values({name: share * large[name] for name in _OF_THE_FIN})
        self._stepper = Stepper(self._model, effects=self._water, step_s=self.step_s)

    def _steps(self, duration_s: float) -> int:
        return round(duration_s / self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        servo = self._servo(self._drives["tail"].angles(time_s))
        tip = self._tip(servo)
        rate = (servo - tip) / _TIP_LAG_S
        late_s = (0.0, _ECHO_S, QUARTER_S)
        late = self._late.after(rate, *(self._steps(_AMPLITUDE_DEAD_S + more_s) for more_s in late_s))
        (late_angle,) = self._angle.after(servo, self._steps(_ANGLE_DEAD_S))
        noise = self._settings.noise / math.sqrt(self.step_s) * self._rng.standard_normal((len(time_s), 2))
        inputs = np.empty((len(time_s) + 1, len(self._model.inputs)))
        inputs[0] = self._inputs_before
        for column, values in enumerate((tip, rate, *late, late_angle, *self._momentum_rate(tip, rate))):
            inputs[1:, column] = values
        inputs[1:, -2:] = noise
        force = self._stepper.advance(inputs)
        self._inputs_before = inputs[-1:].copy()
        require_finite(self._stepper, "caudal tank")
        bar = self._settings.bar_length_m
        rows = np.zeros((len(time_s), len(self.signals)))
        rows[:, :2] = force
        rows[:, 3], rows[:, 4] = bar * force[:, 1], -bar * force[:, 0]
        rows[:, 6] = servo
        felt = [self._columns[signal] for signal in self.sensed]
        rows[:, felt] = self._sensor(rows[:, felt])
        return rows

    def _tip(self, servo: FloatArray) -> FloatArray:
        """Return the tip's angle: the servo's, behind by a first-order lag."""
        tip = _lagged(servo, self._servo_rad, self._tip_rad, self.step_s / _TIP_LAG_S)
        self._servo_rad, self._tip_rad = float(servo[-1]), float(tip[-1])
        return tip

    def _momentum_rate(self, tip: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how fast the momentum of the water along with the fin changes, forward and sideways, rad/s^2."""
        momentum = np.column_stack([rate * np.sin(tip), rate * np.cos(tip)])
        changed = np.diff(momentum, axis=0, prepend=self._momentum[None]) / self.step_s
        self._momentum = momentum[-1].copy()
        return changed[:, 0], changed[:, 1]

    def _recall(self, memory: Mapping[str, Any]) -> None:
        material, thickness_mm, fin = memory["fin"]
        self._put((material, thickness_mm, fin))
        super()._recall({**memory, "fin": self._fin})


@kernel
def _lagged(values: FloatArray, value: float, lagged: float, step: float) -> FloatArray:
    """Return values behind by a first-order lag, exact where they go straight; `step` is in time constants."""
    decay = math.exp(-step)
    ramp = (1.0 - decay) / step
    behind = np.empty(len(values))
    for i in range(len(values)):
        lagged = decay * lagged + (ramp - decay) * value + (1.0 - ramp) * values[i]
        value = values[i]
        behind[i] = lagged
    return behind
