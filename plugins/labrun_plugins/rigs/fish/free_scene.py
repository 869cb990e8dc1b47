"""The fish let loose in a tank or a pool: the same fins, and a body that goes where they push it."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError
from labrun.models import Stepper
from labrun_plugins.rigs.fish.attachments import ATTACHMENTS, AttachmentName
from labrun_plugins.rigs.fish.fins import JOINTS, WATERS, fin_loads, motion_at
from labrun_plugins.rigs.fish.free_model import OUTPUTS, REAR_FINS_YAW_DRAG, free_model
from labrun_plugins.rigs.fish.hand import chosen_by_hand
from labrun_plugins.rigs.fish.watching import Watch
from labrun_plugins.simulated.bench import (
    Bench,
    BenchSettings,
    described,
    hidden_effects,
    joint_model,
    joint_stepper,
    packed,
    unpacked,
)

_STIRRED = {"tank": 1.0, "pool": 0.5}
"""How strong the vortices are: in the pool they spread (chosen)."""


class FireFreeSettings(BenchSettings):
    """What is changed by hand, where no condition says otherwise.

    `attachment`: blades of the pectoral fins. `caudal`: whether tail and dorsal fin are on. `water`: where it swims.
    """

    attachment: AttachmentName = "broad"
    caudal: Literal["on", "off"] = "on"
    water: Literal["tank", "pool"] = "tank"


class FireFree(Bench):
    """The five-jointed fish without the arm.

    Physics and sources: see `five_bar`, `fins` and `free_model`. Nothing but water is at its hull, whose drag is less
    than that of the towed fish with its mount. The tail and the dorsal fin are taken off together, as the source
    did in its tank; the factors by hand are `attachment`, `caudal` and `water`.

    Before a trial a person puts the fish back, at rest.

    Signals: ``x``, ``y`` (m) and ``heading`` (rad, to the left) from where it was put; its speed ``ahead`` and
    ``aside`` (to the left, m/s), its rate of turn ``turning`` (rad/s), and each joint's angle (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = FireFreeSettings
    step_s = 0.01
    scale = Scale(coordinate=0.5, rate=0.2, acceleration=1.0, force=0.3, signal=0.5, time_s=2.0)
    joints = JOINTS
    signals: Mapping[str, str] = {
        **{one.name: one.unit for one in OUTPUTS}, **dict.fromkeys(JOINTS, "rad"),
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(free_model())
        on_joints = [one for one in self._settings.hide if one.site in self.joints]
        in_water = [one for one in self._settings.hide if one.site not in self.joints]
        joint_effects = hidden_effects(on_joints, joint_model(self.joints), self.scale)
        self._water_effects = hidden_effects(in_water, self._model, self.scale)
        self._hidden = self._water_effects + joint_effects
        self._servo = joint_stepper(self.joints, self.step_s, joint_effects) if joint_effects else None
        self._put = {name: getattr(self._settings, name) for name in ("attachment", "caudal", "water")}
        self._stepper = self._fresh_stepper()
        self._watch = Watch()
        self._motion = motion_at(np.zeros(len(JOINTS)))
        self._wake = np.zeros((WATERS, 3))
        self._joints_before = np.zeros((1, len(JOINTS)))
        self._fins_before = np.zeros(4)
        self._inputs_before = np.zeros(len(self._model.inputs))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put the fish back at rest, with the blades, fins and water of the condition."""
        for name, kinds in (("attachment", ATTACHMENTS), ("caudal", ("on", "off")), ("water", _STIRRED)):
            self._put[name] = chosen_by_hand(condition, name, kinds, self._put[name])
        state = self._stepper.state
        state[:6] = 0.0
        self._stepper = self._fresh_stepper()
        self._stepper.state = state
        self._wake[:] = 0.0
        self._watch.clear()

    def answer(self, what: str) -> float | str:
        """Return what somebody with a watch would type after the trial; see `Watch`."""
        thumb = float(self._settings.noise * self._rng.standard_normal())
        return self._watch.read(what, thumb)

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects."""
        names = (one.name for one in self._model.parameters)
        return {
            "parameters": dict(zip(names, self._model.values.tolist(), strict=True)),
            "parameter_errors": dict(self._settings.parameters),
            "hidden": [described(effect) for effect in self._hidden],
        }

    def _fresh_stepper(self) -> Stepper:
        values = dict(
            zip((one.name for one in self._model.parameters), self._model.values.tolist(), strict=True)
        )
        if self._put["caudal"] == "on":
            values["yaw_drag"] += REAR_FINS_YAW_DRAG
        for name in ("vortices", "yaw_vortices"):
            values[name] *= _STIRRED[self._put["water"]]
        return Stepper(self._model, values, effects=self._water_effects, step_s=self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        joints = np.empty((count, len(self.joints)))
        for drive, column in zip(self._drives.values(), joints.T, strict=True):
            drive.write(time_s, column)
        if self._servo is not None:
            commanded = joints
            joints = self._servo.advance(np.concatenate([self._joints_before, commanded]))
            self._joints_before = commanded[-1:].copy()
        before, self._fins_before = self._fins_before, joints[-1, :4].copy()
        noise = self._settings.noise / math.sqrt(self.step_s) * self._rng.standard_normal((count, 3))
        rows = np.empty((count, len(self.signals)))
        rows[:, 6:] = joints
        attachment, caudal = ATTACHMENTS[self._put["attachment"]], self._put["caudal"] == "on"
        going = self._stepper.state[3:6]
        inputs = np.empty((2, len(self._model.inputs)))
        for n in range(count):
            # A tail that nobody drives trails in the flow instead of standing square to it.
            beats = caudal and joints[n, 4] != self._motion[-2]
            loads = fin_loads(
                joints[n : n + 1],
                going[None, :],
                self.step_s,
                self._motion,
                self._wake,
                attachment,
                caudal=beats,
            )[0]
            inputs[0] = self._inputs_before
            inputs[1, :4], inputs[1, 4:] = loads[[0, 1, 5, 6]], noise[n]
            rows[n, :6] = self._stepper.advance(inputs)[0]
            going = rows[n, 3:6]
            self._inputs_before = inputs[1].copy()
        beating = (joints[:, :4] != np.vstack([before, joints[:-1, :4]])).any(axis=1)
        self._watch.look(time_s, rows[:, :3], beating)
        if not self._stepper.finite:
            raise ExperimentError("the simulated free fish blew up", hint="hide a weaker effect, or none")
        return rows

    def _memory(self) -> dict[str, Any]:
        return {
            "put": dict(self._put),
            "motion": packed(self._motion),
            "wake": packed(self._wake),
            "joints_before": packed(self._joints_before),
            "fins_before": packed(self._fins_before),
            "inputs_before": packed(self._inputs_before),
            "servo": None if self._servo is None else self._servo.snapshot(),
            "stepper": self._stepper.snapshot(),
        }

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._put = dict(memory["put"])
        self._stepper = self._fresh_stepper()
        self._motion = unpacked(memory["motion"])
        self._wake = unpacked(memory["wake"])
        self._joints_before = unpacked(memory["joints_before"])
        self._fins_before = unpacked(memory["fins_before"])
        self._inputs_before = unpacked(memory["inputs_before"])
        if self._servo is not None:
            self._servo.restore(memory["servo"])
        self._stepper.restore(memory["stepper"])
