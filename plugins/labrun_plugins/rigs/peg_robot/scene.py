"""A body between pegs, pushed by an arm on a curved beam."""

import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import SpecError
from labrun.models import kernel
from labrun_plugins.rigs.beam.tape_spring_fit import TapeSpring, Width
from labrun_plugins.simulated.bench import Bench, BenchSettings, Passage, described, joint_model

_SCALE = Scale(signal=0.5, time_s=2.0)
_MIL_M = 25.4e-6
_KNOTS = 2000
_DRAG_N_M_S = 1e-3
"""Torque at the arm over its rate that a sliding body takes beside its friction (chosen): motion stays smooth."""
_BETWEEN_MOUNTINGS = 0.01
"""Relative scatter of the sheet's thickness (chosen)."""
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


class PegRobotSettings(BenchSettings):
    """The robot and its pegs; all lengths are chosen.

    Attributes
    ----------
    thickness_mil
        Of the beam's polyester; a condition ``thickness_mil`` changes it.
    width
        What stands for the width in (7.1): the "chord", as (7.2) has it, or the "arc".
    pitch_mm
        Between two pegs.
    arm_mm, beam_mm
        Length of the arm, and of the beam it stands on.
    passes_deg
        An arm bent so far slips past its peg: less than the arm swings to either side, or it never does.
    friction_mn_m
        Of the body on its way, as a torque at the arm.
    scatter
        Factor on the scatter of thickness between mountings.
    """

    thickness_mil: float = Field(default=5.0, ge=1.0, le=20.0)
    width: Literal["chord", "arc"] = "chord"
    pitch_mm: PositiveFloat = 40.0
    arm_mm: PositiveFloat = 60.0
    beam_mm: PositiveFloat = 25.4
    passes_deg: float = Field(default=30.0, gt=5.0, lt=90.0)
    friction_mn_m: PositiveFloat = 9.0
    scatter: NonNegativeFloat = 1.0


class PegRobot(Bench):
    """A body between pegs that an arm on a curved beam pushes along; slow, so that nothing has inertia.

    The arm's tip lies between two pegs. Swinging back it meets the one behind it and bends in opposite sense, swinging
    forward the one ahead, in equal sense. The torque in the beam is that of (7.1) at the curvature that bends it by so
    much; in equal sense it goes no higher than (7.8). What exceeds the friction of the body moves it.

    Joint: ``arm``, from straight across, positive to the front. Signals: ``robot_x`` ... ``robot_qw``, pose of the
    body (m; unit quaternion), x along the pegs; ``position`` (m); ``arm`` (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = PegRobotSettings
    step_s = 0.0005
    scale = _SCALE
    joints = ("arm",)
    sensed = ("position",)
    remembered = ("thickness_mil", "factor", "body", "servo", "sight")
    signals: Mapping[str, str] = {
        **{f"robot_{axis}": "m" if axis in "xyz" else "1" for axis in _POSE}, "position": "m", "arm": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = joint_model(self.joints)
        keys = self._settings
        in_sight = [hidden for hidden in keys.hide if hidden.site not in self.joints]
        self._servo = self._passage(self.joints)
        self._sight = Passage(self.sensed, in_sight, _SCALE, self.step_s)
        self._spread = 0.0 if keys.as_modelled else keys.scatter * keys.noise * _BETWEEN_MOUNTINGS
        # body, and the peg behind the arm's tip, as a number of pitches: the tip begins in the middle of a gap
        self._body = np.array([0.5e-3 * keys.pitch_mm, 0.0])
        self._put(keys.thickness_mil, 1.0 + self._spread * rng.standard_normal())

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Put in a beam of the condition's ``thickness_mil``; one that is in place stays."""
        wanted = condition.get("thickness_mil", self._thickness_mil)
        if isinstance(wanted, str) or not 1.0 <= wanted <= 20.0:
            raise SpecError(
                f"thickness_mil = {wanted!r} is not to be had",
                hint="sheets of 1 to 20 mil are; the source had 3, 5 and 10",
            )
        if wanted != self._thickness_mil:
            self._put(float(wanted), 1.0 + self._spread * self._rng.standard_normal())

    def mount(self, number: int) -> None:  # noqa: ARG002  (every mounting is another sheet of the same thickness)
        """Put in a new beam of the thickness that is asked for."""
        self._put(self._thickness_mil, 1.0 + self._spread * self._rng.standard_normal())

    def truth(self) -> dict[str, Any]:
        """Return the beam, its limits, and hidden effects."""
        strip = self._strip()
        return {
            "thickness_mil": self._thickness_mil,
            "parameters": {
                "equal_limit": strip.equal_limit_n_m,
                "opposite_limit": strip.opposite_limit_n_m,
                "friction": 1e-3 * self._settings.friction_mn_m,
            },
            "parameter_errors": {},
            "hidden": [described(effect) for effect in (*self._servo.effects, *self._sight.effects)],
        }

    def _strip(self) -> TapeSpring:
        return TapeSpring(self._thickness_mil * self._factor * _MIL_M, width=self._settings.width)

    def _put(self, thickness_mil: float, factor: float) -> None:
        self._thickness_mil, self._factor = thickness_mil, float(factor)
        keys = self._settings
        self._torques = beam_torques(
            thickness_mil * self._factor, keys.width, 1e-3 * keys.beam_mm, math.radians(keys.passes_deg)
        )
        self._numbers = np.array([
            1e-3 * keys.pitch_mm, 1e-3 * keys.arm_mm, math.radians(keys.passes_deg), 1e-3 * keys.friction_mn_m,
            self._strip().equal_limit_n_m, self.step_s,
        ])  # fmt: skip

    def _advance(self, time_s: FloatArray) -> FloatArray:
        arm = self._servo(self._drives["arm"].angles(time_s))
        seen = self._sight(_crawl(arm, self._body, self._torques, self._numbers))
        zero = np.zeros_like(seen)
        return np.column_stack([seen, zero, zero, zero, zero, zero, zero + 1.0, seen, arm])

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._put(memory["thickness_mil"], memory["factor"])
        super()._recall(memory)


@functools.cache
def beam_torques(thickness_mil: float, width: Width, beam_m: float, most_rad: float) -> FloatArray:
    """Return the torque of a beam bent in opposite sense, N m, at even bends from 0 to `most_rad`, by (7.1)."""
    strip = TapeSpring(thickness_mil * _MIL_M, width=width)
    bends = np.linspace(0.0, most_rad, _KNOTS)
    return np.array([strip.torque_n_m(float(bend) / beam_m) for bend in bends])


@kernel
def _crawl(arm: FloatArray, body: FloatArray, torques: FloatArray, numbers: FloatArray) -> FloatArray:
    """Return where the body is at every angle of the arm; `body` holds its place and the peg behind the tip."""
    pitch, length, passes, friction, equal_limit, step_s = numbers
    spacing = passes / (len(torques) - 1)
    slope = torques[1] / spacing
    x, peg = body
    places = np.empty(len(arm))
    for i in range(len(arm)):
        tip = x + length * math.sin(arm[i])
        torque = 0.0
        behind, ahead = peg * pitch, (peg + 1.0) * pitch
        if tip < behind or tip > ahead:
            reach = ((behind if tip < behind else ahead) - x) / length
            bend = math.copysign(passes, reach - math.sin(arm[i]))
            if abs(reach) < 1.0:
                bend = math.asin(reach) - arm[i]
            if abs(bend) >= passes:  # it slips past, into the next gap
                peg += -1.0 if bend > 0.0 else 1.0
            elif bend > 0.0:
                index = int(bend / spacing)
                share = bend / spacing - index
                torque = torques[index] + share * (torques[index + 1] - torques[index])
            else:
                torque = max(slope * bend, -equal_limit)
        if abs(torque) > friction:
            x += step_s * length * (torque - math.copysign(friction, torque)) / _DRAG_N_M_S
        places[i] = x
    body[0], body[1] = x, peg
    return places
