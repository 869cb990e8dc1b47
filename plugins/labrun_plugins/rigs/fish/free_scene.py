"""The fish let loose in a tank or a pool: the same fins, and a body that goes where they push it.

The fish let loose: a rigid body that goes ahead, aside and about its vertical axis, in water that stirs it.

Kirchhoff's equations of a body in an ideal fluid, in the plane (Lamb, Hydrodynamics (1932), section 124), with the
loads of the fins and quadratic drag,

    ``m_a u' =  m_s v r + F_x - c_a u|u|``
    ``m_s v' = -m_a u r + F_y - c_s v|v|``
    ``I r'   = (m_a - m_s) u v + N_z - c_r r|r|``

with u ahead, v to the left, r the turn to the left, m_a and m_s the masses with the water that moves along.
Without fins and drag they keep the kinetic energy. They stand in ``free.toml``.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError, SpecError
from labrun.models import Stepper
from labrun_plugins.rigs.fish.fins import ATTACHMENTS, JOINTS, WATERS, AttachmentName, fin_loads, motion_at
from labrun_plugins.simulated.bench import Bench, BenchSettings, model_beside, require_finite

REAR_FINS_YAW_DRAG = 0.041
"""What a tail at rest and the dorsal fin add to the yaw drag, N m s^2."""
_COURSE = {"x": "m", "y": "m", "heading": "rad", "ahead": "m/s", "aside": "m/s", "turning": "rad/s"}
ANSWERS = ("seconds_per_turn", "seconds_over_distance", "swims")
_REACTION_S = 0.1
"""Scatter of a thumb on a watch, at either end (chosen)."""
_SWIMS_M = 0.1
"""A fish that gets farther than that swims (chosen: a fifth of its length)."""


class Watch:
    """Keeps the course of a trial while the fins beat, and reads it as a person would.

    The first full turn, or the first `distance_m`, is left to the fish to get up to its speed; all that follow until
    the fins stop are timed together. One that makes no second is timed over its last, and one that does not get so far
    over what there is.
    """

    def __init__(self, distance_m: float = 1.0) -> None:
        self._distance_m = distance_m
        self._blocks: list[FloatArray] = []

    def clear(self) -> None:
        """Begin anew: the fish was put back."""
        self._blocks = []

    def look(self, time_s: FloatArray, course: FloatArray, beating: FloatArray) -> None:
        """Take in place and heading, shape (n, 3), and whether fins beat, shape (n,)."""
        self._blocks.append(np.column_stack([time_s, course, beating]))

    def read(self, what: str, thumb: float) -> float | str:
        """Return what a person would type.

        `what`: one of `ANSWERS`. `thumb`: how late the watch is stopped, in standard deviations. Raises
        ExperimentError: something else is asked for, or nothing was seen.
        """
        if what not in ANSWERS:
            raise ExperimentError(
                f"nobody can read {what!r} off this fish",
                hint=f"objectives.NAME.reads is one of {', '.join(ANSWERS)}",
            )
        seen = np.concatenate(self._blocks) if self._blocks else np.empty((0, 5))
        beats = np.flatnonzero(seen[:, 4])
        if len(beats) < 2:
            raise ExperimentError("no fin was seen to move", hint="look at the gait of this condition")
        seen = seen[beats[0] : beats[-1] + 1]
        if what == "swims":
            return "yes" if math.hypot(*(seen[-1, 1:3] - seen[0, 1:3])) > _SWIMS_M else "no"
        if what == "seconds_per_turn":
            way, elapsed, whole = (
                np.abs(seen[-1, 3] - seen[:, 3]),
                np.abs(seen[:, 3] - seen[0, 3]),
                2.0 * math.pi,
            )
        else:
            way = np.hypot(*(seen[-1, 1:3] - seen[:, 1:3]).T)
            elapsed, whole = np.hypot(*(seen[:, 1:3] - seen[0, 1:3]).T), self._distance_m
        up_to_speed = np.flatnonzero(elapsed >= whole)
        left = way[up_to_speed[0]] if len(up_to_speed) else 0.0
        far = np.flatnonzero(way >= max(1, math.floor(left / whole)) * whole)
        first = int(far[-1]) if len(far) else 0
        share = max(float(way[first]), 1e-9) / whole
        seconds = float(seen[-1, 0] - seen[first, 0]) + math.sqrt(2.0) * _REACTION_S * thumb
        # A watch shows tenths of all turns together; a person divides afterwards.
        return round(max(round(seconds, 1), 0.1) / share, 2)


def chosen_by_hand(
    condition: Mapping[str, float | str], name: str, kinds: Iterable[str], otherwise: str
) -> str:
    """Return which kind of `name` a condition asks for; `otherwise` where it does not say.

    Raises SpecError: there is no such kind.
    """
    wanted = condition.get(name, otherwise)
    known = list(kinds)
    if wanted not in known:
        raise SpecError(f"this fish has no {name} {wanted!r}", hint=f"it has {', '.join(known)}")
    return str(wanted)


_STIRRED = {"tank": 1.0, "pool": 0.5}
"""How strong the vortices are: in the pool they spread (chosen)."""


class FireFreeSettings(BenchSettings):
    """What is changed by hand, where no condition says otherwise.

    `attachment`: blades of the pectoral fins. `caudal`: whether tail and dorsal fin are on. `water`: where it swims.
    `distance_m`: the distance over which a person times it; a dry run's fish meets no wall.
    """

    attachment: AttachmentName = "broad"
    caudal: Literal["on", "off"] = "on"
    water: Literal["tank", "pool"] = "tank"
    distance_m: PositiveFloat = 1.0


class FireFree(Bench):
    """The five-jointed fish without the arm.

    Physics and sources: see `five_bar`, `fins` and ``free.toml``. Nothing but water is at its hull, whose drag is less
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
    remembered = ("put", "motion", "wake", "fins_before", "inputs_before", "servo", "stepper")
    signals: Mapping[str, str] = {
        **_COURSE, **dict.fromkeys(JOINTS, "rad"),
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(model_beside(__file__, "free.toml"))
        self._water_effects = self._inside()
        self._servo = self._passage(self.joints)
        self._hidden = self._water_effects + self._servo.effects
        self._put = {name: getattr(self._settings, name) for name in ("attachment", "caudal", "water")}
        self._stepper = self._fresh_stepper()
        self._watch = Watch(self._settings.distance_m)
        self._motion = motion_at(np.zeros(len(JOINTS)))
        self._wake = np.zeros((WATERS, 3))
        self._fins_before = np.zeros(len(JOINTS))
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
        return self._truth(self._hidden)

    def _fresh_stepper(self) -> Stepper:
        values = self._model.named_values
        if self._put["caudal"] == "on":
            values["yaw_drag"] += REAR_FINS_YAW_DRAG
        for name in ("vortices", "yaw_vortices"):
            values[name] *= _STIRRED[self._put["water"]]
        return Stepper(self._model, values, effects=self._water_effects, step_s=self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        count = len(time_s)
        commanded = np.empty((count, len(self.joints)))
        for drive, column in zip(self._drives.values(), commanded.T, strict=True):
            drive.write(time_s, column)
        joints = self._servo(commanded)
        before, self._fins_before = self._fins_before, joints[-1].copy()
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
        beating = (joints != np.vstack([before, joints[:-1]])).any(axis=1)
        self._watch.look(time_s, rows[:, :3], beating)
        require_finite(self._stepper, "free fish")
        return rows

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._put = dict(memory["put"])
        self._stepper = self._fresh_stepper()
        super()._recall(memory)
