"""A servo that swings a body through an elastic strip, with cameras on both."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, NonNegativeFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import SpecError
from labrun.models import Stepper
from labrun_plugins.simulated.bench import Bench, BenchSettings, model_beside, require_finite, unpacked

_PIVOT_M = (0.2, 0.0, 1.1)
_GRAVITY_M_S2 = 9.81
_LEVER_M = 0.05
_HORN_M = 0.02
_STRIP_MM = 25.0
_SCALE = Scale(coordinate=0.4, rate=5.0, acceleration=50.0, force=0.05, signal=0.4, time_s=0.5)
_BETWEEN_SETUPS = (0.02, 0.03)
"""Relative scatter of stiffness and damping from setup to setup, after Table 3.2 of the source's hinges."""
_PARTS = ("angle", "horn")


class DrivenJointSettings(BenchSettings):
    """What the joint carries, and what it turns in.

    Attributes
    ----------
    payload_g
        Mass at the end of the arm; a condition ``payload_g`` changes it.
    up
        +1 as drawn, the arm hanging down; -1 the whole bench turned over. A condition ``up`` changes it.
    strip_mm
        Width of the strip; a condition ``strip_mm`` exchanges it.
    friction_mn_m
        Of the pin: 0 for ball bearings, about 3 for a dry bushing (chosen).
    drag_n_m_s2
        Torque of the air over the square of the body's rate; 2e-6 is that of a plate of 50 mm by 100 mm (chosen).
    scatter
        Factor on the scatter between setups.
    """

    payload_g: float = Field(default=40.0, ge=0.0, le=200.0)
    up: float = 1.0
    strip_mm: float = _STRIP_MM
    friction_mn_m: NonNegativeFloat = 0.0
    drag_n_m_s2: NonNegativeFloat = 2e-6
    scatter: NonNegativeFloat = 1.0


class DrivenJoint(Bench):
    """A body that turns on a pin, pulled by a servo's horn through an elastic strip.

    Physics: see ``bench.toml``. The servo is stiff: what the body does is not felt by the horn. A person
    screws another payload on, exchanges the strip, and turns the whole bench over; angles are counted from the bench's
    own zero throughout, which lies along gravity but for the parameter ``tilt``. All strips of a run are cut from one
    sheet; from run to run stiffness and damping scatter. With `as_modelled` there is no drag of the air.

    Signals: ``arm_x`` ... ``arm_qw`` and ``horn_x`` ... ``horn_qw``, poses of body and horn (m; unit quaternion; the
    axis is y, the pivot at (0.2, 0, 1.1) m); ``angle`` and ``horn``, their angles (rad); ``base``, the servo's (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = DrivenJointSettings
    step_s = 0.001
    scale = _SCALE
    joints = ("base",)
    sensed = _PARTS
    remembered = ("factors", "mounted", "base_before", "set", "servo", "sight", "stepper")
    signals: Mapping[str, str] = {
        **{f"{part}_{axis}": "m" if axis in "xyz" else "1"
           for part in ("arm", "horn") for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")},
        "angle": "rad", "horn": "rad", "base": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        spread = self._settings.scatter * self._settings.noise * np.array(_BETWEEN_SETUPS)
        self._servo, self._sight = self._passage(self.joints), self._passage(self.sensed)
        self._base_before = np.zeros(1)
        self._set_up(np.maximum(1.0 + spread * rng.standard_normal(2), 0.0))
        self._put({name: float(getattr(self._settings, name)) for name in ("payload_g", "up", "strip_mm")})

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Screw on the payload, turn the bench, and exchange the strip: ``payload_g``, ``up``, ``strip_mm``."""
        wanted = {name: float(condition.get(name, value)) for name, value in self._mounted.items()}
        if wanted != self._mounted:
            self._put(wanted)

    def truth(self) -> dict[str, Any]:
        """Return what is mounted, parameters as they are on the bench, and hidden effects."""
        return self._truth(
            (*self._at_hinge, *self._servo.effects, *self._sight.effects), mounted=dict(self._mounted)
        )

    def _set_up(self, factors: FloatArray) -> None:
        """Take a setup, whose factors on stiffness and damping these are."""
        drag = 0.0 if self._settings.as_modelled else self._settings.drag_n_m_s2
        mounted = {"friction": 1e-3 * self._settings.friction_mn_m, "drag": drag}
        model = model_beside(__file__, "bench.toml").with_values(mounted)
        nominal = model.named_values
        scattered = {name: nominal[name] * factors[i] for i, name in enumerate(("stiffness", "damping"))}
        self._factors = factors
        self._model = self._with_errors(model.with_values(scattered))
        self._values = self._model.named_values
        self._at_hinge = self._inside()
        self._stepper = Stepper(self._model, effects=self._at_hinge, step_s=self.step_s)

    def _put(self, mounted: dict[str, float]) -> None:
        """Change what is mounted; whoever does it holds the body where it is meanwhile."""
        payload_kg, up, share = 1e-3 * mounted["payload_g"], mounted["up"], mounted["strip_mm"] / _STRIP_MM
        for name, holds, expected in (
            ("payload_g", 0.0 <= payload_kg <= 0.2, "0 to 200 g"),
            ("up", abs(up) == 1.0, "1, hanging, or -1, turned over"),
            ("strip_mm", 0.2 <= share <= 4.0, "a strip of 5 to 100 mm"),
        ):
            if not holds:
                raise SpecError(
                    f"{name} = {mounted[name]:g} is not to be had on this bench",
                    hint=f"{name} may be {expected}",
                )
        gravity = _GRAVITY_M_S2 * (self._values["moment"] + payload_kg * self._values["payload_lever"])
        stiffness = self._values["stiffness"] * share
        if up < 0 and gravity >= stiffness:
            raise SpecError(
                f"turned over, the arm with {mounted['payload_g']:g} g on it tips over: its strip is too weak",
                hint="take a smaller payload_g, a wider strip_mm, or up = 1",
            )
        self._mounted = mounted
        base = float(self._base_before[0])
        inertia = self._values["inertia"] + payload_kg * self._values["payload_lever"] ** 2
        self._stepper.state = (self._stepper.state[0], -self._values["damping"] * share / inertia * base)
        self._set = np.array([up, payload_kg, share])

    def _advance(self, time_s: FloatArray) -> FloatArray:
        base = self._servo(self._drives["base"].angles(time_s))
        edges = np.append(self._base_before, base)
        self._base_before = base[-1:].copy()
        steady = np.broadcast_to(self._set, (len(edges), len(self._set)))
        true = self._stepper.advance(np.column_stack([edges, steady]))
        require_finite(self._stepper, "driven joint")
        seen = self._sight(true)
        return np.column_stack([_pose(seen[:, 0], _LEVER_M), _pose(seen[:, 1], _HORN_M), seen, base])

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._set_up(unpacked(memory["factors"]))
        super()._recall(memory)


def _pose(angle: FloatArray, lever_m: float) -> FloatArray:
    """Return the pose of a body whose middle is `lever_m` below the pivot at angle zero, shape (n, 7)."""
    zero = np.zeros_like(angle)
    return np.column_stack([
        _PIVOT_M[0] - lever_m * np.sin(angle), zero + _PIVOT_M[1], _PIVOT_M[2] - lever_m * np.cos(angle),
        zero, np.sin(angle / 2), zero, np.cos(angle / 2),
    ])  # fmt: skip
