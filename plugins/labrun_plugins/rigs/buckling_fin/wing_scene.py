"""A wing on a servo, its mount on a force/torque sensor, in water or in air (sections 7.5 and 7.6 of the source)."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import SpecError
from labrun.models import Model, Stepper
from labrun_plugins.rigs.buckling_fin.wings import CONDITIONS, OF_THE_BEAM, Medium, wing
from labrun_plugins.simulated.bench import Bench, BenchSettings, hidden_effects, require_finite, unpacked

_SCALE = Scale(coordinate=0.5, rate=0.4, acceleration=10.0, force=0.2, signal=0.5, time_s=2.0)
_KNOWN: Mapping[str, tuple[float, ...]] = {"beams": (1.0, 2.0), "wings": (1.0, 2.0), "short": (0.0, 1.0)}
_BETWEEN_MOUNTINGS = (0.01, 0.02)
"""Relative scatter of the slopes and of the limits of a beam from mounting to mounting (chosen)."""
_FELT = ("force_x", "force_y", "torque_z")
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_HEIGHT_M = 0.3
"""Of the markers above the sensor: they stand on masts, out of the water."""


class FlappingWingSettings(BenchSettings):
    """What is mounted, and what it flaps in.

    Attributes
    ----------
    medium
        "water" or "air".
    beams
        How many under a wing, 1 or 2; a condition ``beams`` changes it.
    wings
        In water 1, or 2, mirrored; a condition ``wings`` changes it.
    short
        In air 1 for the short beam in place of the long one; a condition ``short`` changes it.
    coupling_hz, coupling_damping
        Natural frequency and damping ratio of the wing's base on the servo's shaft: what is compliant between them
        (chosen).
    scatter
        Factor on the scatter between mountings.
    """

    medium: Medium = "water"
    beams: Literal[1, 2] = 1
    wings: Literal[1, 2] = 1
    short: Literal[0, 1] = 0
    coupling_hz: PositiveFloat = 60.0
    coupling_damping: PositiveFloat = 1.0
    scatter: NonNegativeFloat = 1.0


class FlappingWing(Bench):
    """Load on the mount of a wing that a servo flaps, its beam buckling to one side.

    Physics: see `equations`. The joint ``wing`` is the servo's shaft; of two wings it drives both.

    Signals: ``force_x``, ``force_y`` (N) and ``torque_z`` (N m) on the sensor, which sits on the shaft's axis, x to
    the front, z up; ``link_x`` ... ``link_qw`` and ``plate_x`` ... ``plate_qw``, poses of both parts of the wing (m;
    unit quaternion); ``wing``, angle of the shaft, positive to the front (rad): a turn about minus z. While the wing
    swings back, which is its power stroke, ``torque_z`` is negative. Two wings are mirrored: of their load only
    ``force_x`` is left.
    """

    Settings: ClassVar[type[BenchSettings]] = FlappingWingSettings
    step_s = 0.001
    steps_are_beyond_model = True
    scale = _SCALE
    joints = ("wing",)
    sensed = _FELT
    remembered = ("mounted", "factors", "shaft_before", "servo", "stepper")
    signals: Mapping[str, str] = {
        "force_x": "N", "force_y": "N", "torque_z": "N m",
        **{f"{part}_{axis}": "m" if axis in "xyz" else "1" for part in ("link", "plate") for axis in POSE},
        "wing": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._servo = self._passage(self.joints)
        self._shaft_before = np.zeros((1, 1))
        spread = 0.0 if self._settings.as_modelled else self._settings.scatter * self._settings.noise
        self._spread = spread * np.array(_BETWEEN_MOUNTINGS)
        self._put(
            {name: float(getattr(self._settings, name)) for name in CONDITIONS[self._settings.medium]},
            self._scattered(),
        )

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Mount what ``beams``, ``wings`` or ``short`` say; what is mounted already stays as it is."""
        wanted = {name: condition.get(name, value) for name, value in self._mounted.items()}
        for name, value in wanted.items():
            if value not in _KNOWN[name]:
                raise SpecError(
                    f"{name} = {value!r} is not to be had on this bench",
                    hint=f"{name} may be {' or '.join(f'{value:g}' for value in _KNOWN[name])}",
                )
        if wanted != self._mounted:
            self._put({name: float(value) for name, value in wanted.items()}, self._scattered())

    def mount(self, number: int) -> None:  # noqa: ARG002  (every mounting is another beam of the same kind)
        """Clamp new beams of the kind that is asked for."""
        self._put(self._mounted, self._scattered())

    def truth(self) -> dict[str, Any]:
        """Return what is mounted, parameters as they are on the bench, and hidden effects."""
        return self._truth((*self._at_wing, *self._servo.effects), mounted=dict(self._mounted))

    def _scattered(self) -> FloatArray:
        """Return the factors on slopes and limits that one mounting has."""
        factors: FloatArray = 1.0 + self._spread * self._rng.standard_normal(2)
        return factors

    def _put(self, mounted: dict[str, float], factors: FloatArray) -> None:
        """Mount a wing; whoever does it holds the plate where it hangs meanwhile."""
        self._mounted, self._factors = mounted, factors
        model = wing(self._settings.medium)
        nominal = model.named_values
        scattered = {
            name: nominal[name] * factors[1 if name.endswith("limit") else 0] for name in OF_THE_BEAM
        }
        keys = self._settings
        coupling = {"servo_frequency": keys.coupling_hz, "servo_damping": keys.coupling_damping}
        self._model: Model = self._with_errors(model.with_values(scattered | coupling))
        at_wing = [hidden for hidden in keys.hide if hidden.site not in self.joints]
        self._at_wing = hidden_effects(at_wing, self._model, _SCALE)
        values = self._model.named_values
        self._lengths_m = (values["link"], values["arm"])
        here = float(self._shaft_before[0, 0])
        self._stepper = Stepper(
            self._model,
            condition=mounted,
            effects=self._at_wing,
            step_s=self.step_s,
            initial_state=[here, 0.0, 0.0, 0.0],
        )

    def _advance(self, time_s: FloatArray) -> FloatArray:
        shaft = self._servo(self._drives["wing"].angles(time_s))
        driven = np.concatenate([self._shaft_before, shaft[:, None]])
        self._shaft_before = driven[-1:].copy()
        states = self._stepper.advance(driven)
        require_finite(self._stepper, "wing")
        return np.column_stack([states[:, :3], *poses(states[:, 3], states[:, 4], *self._lengths_m), shaft])

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._shaft_before = unpacked(memory["shaft_before"])
        self._put(memory["mounted"], unpacked(memory["factors"]))
        super()._recall(memory)


def poses(link: FloatArray, plate: FloatArray, link_m: float, arm_m: float) -> tuple[FloatArray, FloatArray]:
    """Return the poses of the middles of link and plate of a left fin on a body at rest, each of shape (n, 7).

    Parameters
    ----------
    link, plate : (n,)
        Angles from the body's side, positive to the front, rad.
    """
    zero = np.zeros_like(link)
    ends = np.column_stack([link_m * np.sin(link), link_m * np.cos(link)])
    middles = (0.5 * ends, ends + arm_m * np.column_stack([np.sin(plate), np.cos(plate)]))
    first, second = (
        np.column_stack([
            middle, zero + _HEIGHT_M, zero, zero, -np.sin(0.5 * angle), np.cos(0.5 * angle),
        ])
        for middle, angle in zip(middles, (link, plate), strict=True)
    )  # fmt: skip
    return first, second
