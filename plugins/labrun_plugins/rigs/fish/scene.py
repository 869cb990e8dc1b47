"""The fish with two pectoral five-bars and a tail, on an arm that can tow it (section 6 of the source work).

What the water of the tank adds to the loads on its fins (body drag, waves, vortices) stands in ``tank.toml``.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.models import Stepper
from labrun_plugins.rigs.fish.fins import ATTACHMENTS, JOINTS, WATERS, AttachmentName, fin_loads, motion_at
from labrun_plugins.rigs.fish.free_scene import chosen_by_hand
from labrun_plugins.simulated.bench import (
    BenchSettings,
    TowedBench,
    model_beside,
    require_finite,
)

_FELT = {**{f"force_{axis}": "N" for axis in "xyz"}, **{f"torque_{axis}": "N m" for axis in "xyz"}}
_SCALE = Scale(coordinate=0.5, rate=0.2, acceleration=1.0, force=0.3, signal=0.5, time_s=2.0)


class FireTankSettings(BenchSettings):
    """`mount_height_m`: the sensor sits this far above the fish's centre, at the end of the arm.

    `attachment`: the blades of the pectoral fins, where no condition says otherwise.
    """

    mount_height_m: PositiveFloat = 0.15
    attachment: AttachmentName = "broad"


class FireTank(TowedBench):
    """Six-axis load on the five-jointed fish.

    Physics and sources: see `five_bar`, `fins` and ``tank.toml``.

    With `as_modelled` it is integrated in finer steps: at 10 ms the loads are 5 ms old, which no model of it says.

    Blades are changed by hand: the factor `attachment`.

    A trial leaves moving water at each fin (2 s), waves between the walls (about 6 s) and vortices (2 s)
    behind.

    Signals: ``force_x`` ... ``torque_z`` at the sensor (x forward, y left, z up), ``position`` of the
    carriage (m), and each joint's angle (rad). The carriage tows the fish forward for rising position: water
    comes from ahead at its speed.
    """

    Settings: ClassVar[type[BenchSettings]] = FireTankSettings
    step_s = 0.01
    fine_step_s = 0.0025
    scale = _SCALE
    joints = JOINTS
    remembered = ("attachment", "carriage", "motion", "wake", "inputs_before", "servo", "stepper")
    signals: Mapping[str, str] = {
        **_FELT, "position": "m", **dict.fromkeys(JOINTS, "rad"),
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        model = model_beside(__file__, "tank.toml")
        self._model = self._with_errors(model.with_values({"mount_height": self._settings.mount_height_m}))
        water_effects = self._inside()
        self._servo = self._passage(self.joints)
        self._hidden = water_effects + self._servo.effects
        self._stepper = Stepper(self._model, effects=water_effects, step_s=self.step_s)
        self._motion = motion_at(np.zeros(len(JOINTS)))
        self._wake = np.zeros((WATERS, 3))
        self._attachment: str = self._settings.attachment
        self._inputs_before = np.zeros((1, len(self._model.inputs)))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put on the blades of the condition."""
        self._attachment = chosen_by_hand(condition, "attachment", ATTACHMENTS, self._attachment)

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """Return the true signals at ascending times, shape (n, signals)."""
        # Where a carriage at rest stands is known without the water.
        if self._began and self._carriage.at_rest and list(signals) == ["position"]:
            return np.full((len(time_s), 1), self._carriage.position_m)
        return super().observe(signals, time_s)

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects."""
        return self._truth(self._hidden)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        commanded = np.empty((count, len(self.joints)))
        for drive, column in zip(self._drives.values(), commanded.T, strict=True):
            drive.write(time_s, column)
        joints = self._servo(commanded)
        position, speed, acceleration = self._carriage.motion(time_s)
        going = np.zeros((count, 3))
        going[:, 0] = speed
        blades = ATTACHMENTS[self._attachment]
        loads = fin_loads(joints, going, self.step_s, self._motion, self._wake, blades)
        noise = self._settings.noise / math.sqrt(self.step_s) * self._rng.standard_normal((count, 3))
        inputs = np.empty((count + 1, len(self._model.inputs)))
        inputs[0] = self._inputs_before
        inputs[1:, :7], inputs[1:, 7], inputs[1:, 8], inputs[1:, 9:] = loads, speed, acceleration, noise
        wrench = self._stepper.advance(inputs)
        self._inputs_before = inputs[-1:].copy()
        require_finite(self._stepper, "fire tank")
        rows = np.empty((count, len(self.signals)))
        rows[:, :6], rows[:, 6], rows[:, 7:] = wrench, position, joints
        return rows
