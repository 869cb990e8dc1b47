"""The fish with two pectoral five-bars and a tail, on an arm that can tow it (section 6 of the source work)."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError
from labrun.models import Stepper
from labrun_plugins.rigs.fish.attachments import ATTACHMENTS, AttachmentName
from labrun_plugins.rigs.fish.fins import JOINTS, WATERS, fin_loads, motion_at
from labrun_plugins.rigs.fish.hand import chosen_by_hand
from labrun_plugins.rigs.fish.model import OUTPUTS, fire_model
from labrun_plugins.simulated.bench import (
    ACCELERATION_M_S2,
    Bench,
    BenchSettings,
    Carriage,
    described,
    hidden_effects,
    joint_model,
    joint_stepper,
    packed,
    unpacked,
)

_SCALE = Scale(coordinate=0.5, rate=0.2, acceleration=1.0, force=0.3, signal=0.5, time_s=2.0)


class FireTankSettings(BenchSettings):
    """`mount_height_m`: the sensor sits this far above the fish's centre, at the end of the arm.

    `attachment`: the blades of the pectoral fins, where no condition says otherwise.
    """

    mount_height_m: PositiveFloat = 0.15
    attachment: AttachmentName = "broad"


class FireTank(Bench):
    """Six-axis load on the five-jointed fish.

    Physics and sources: see `five_bar`, `fins` and `model`.

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
    signals: Mapping[str, str] = {
        **{one.name: one.unit for one in OUTPUTS}, "position": "m", **dict.fromkeys(JOINTS, "rad"),
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(fire_model(self._settings.mount_height_m))
        on_joints = [one for one in self._settings.hide if one.site in self.joints]
        in_water = [one for one in self._settings.hide if one.site not in self.joints]
        joint_effects = hidden_effects(on_joints, joint_model(self.joints), _SCALE)
        water_effects = hidden_effects(in_water, self._model, _SCALE)
        self._hidden = water_effects + joint_effects
        self._servo = joint_stepper(self.joints, self.step_s, joint_effects) if joint_effects else None
        self._stepper = Stepper(self._model, effects=water_effects, step_s=self.step_s)
        self._carriage = Carriage()
        self._motion = motion_at(np.zeros(len(JOINTS)))
        self._wake = np.zeros((WATERS, 3))
        self._attachment: str = self._settings.attachment
        self._joints_before = np.zeros((1, len(JOINTS)))
        self._inputs_before = np.zeros((1, len(self._model.inputs)))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put on the blades of the condition."""
        self._attachment = chosen_by_hand(condition, "attachment", ATTACHMENTS, self._attachment)

    def tow(
        self,
        from_m: float,
        to_m: float,
        speed_m_s: float,
        start_s: float,
        acceleration_m_s2: float = ACCELERATION_M_S2,
    ) -> None:
        """Move the carriage from `start_s` on."""
        self._carriage.move(from_m, to_m, speed_m_s, start_s, acceleration_m_s2)

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """Return the true signals at ascending times, shape (n, signals)."""
        # Where a carriage at rest stands is known without the water.
        if self._began and self._carriage.at_rest and list(signals) == ["position"]:
            return np.full((len(time_s), 1), self._carriage.position_m)
        return super().observe(signals, time_s)

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects."""
        names = (one.name for one in self._model.parameters)
        return {
            "parameters": dict(zip(names, self._model.values.tolist(), strict=True)),
            "parameter_errors": dict(self._settings.parameters),
            "hidden": [described(effect) for effect in self._hidden],
        }

    def _advance(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        commanded = np.empty((count, len(self.joints)))
        for drive, column in zip(self._drives.values(), commanded.T, strict=True):
            drive.write(time_s, column)
        joints = commanded
        if self._servo is not None:
            joints = self._servo.advance(np.concatenate([self._joints_before, commanded]))
            self._joints_before = commanded[-1:].copy()
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
        if not self._stepper.finite:
            raise ExperimentError("the simulated fire tank blew up", hint="hide a weaker effect, or none")
        rows = np.empty((count, len(self.signals)))
        rows[:, :6], rows[:, 6], rows[:, 7:] = wrench, position, joints
        return rows

    def _memory(self) -> dict[str, Any]:
        return {
            "attachment": self._attachment,
            "carriage": self._carriage.snapshot(),
            "motion": packed(self._motion),
            "wake": packed(self._wake),
            "joints_before": packed(self._joints_before),
            "inputs_before": packed(self._inputs_before),
            "servo": None if self._servo is None else self._servo.snapshot(),
            "stepper": self._stepper.snapshot(),
        }

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._attachment = memory["attachment"]
        self._carriage.restore(memory["carriage"])
        self._motion = unpacked(memory["motion"])
        self._wake = unpacked(memory["wake"])
        self._joints_before = unpacked(memory["joints_before"])
        self._inputs_before = unpacked(memory["inputs_before"])
        if self._servo is not None:
            self._servo.restore(memory["servo"])
        self._stepper.restore(memory["stepper"])
