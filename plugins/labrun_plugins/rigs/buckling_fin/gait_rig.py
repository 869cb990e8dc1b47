"""The swimmer of two fins on an arm under a carriage that a sensor holds (section 7.8 of the source work)."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.models import Model, Stepper
from labrun_plugins.rigs.buckling_fin.model import fin_model
from labrun_plugins.rigs.buckling_fin.wings import SHORT_BEAM
from labrun_plugins.simulated.bench import Bench, BenchSettings, hidden_effects, require_finite, unpacked

_SCALE = Scale(coordinate=0.5, rate=0.4, acceleration=10.0, force=0.2, signal=0.5, time_s=2.0)
_FELT = ("force_x", "force_y", "torque_z")
_FINS = ("fin_1", "fin_2")
_OF_THE_BEAM = ("stiffness", "equal_limit", "opposite_limit", "buckled_stiffness")
_FIN_WIDTH_M = 0.080
_BODY_WIDTH_M = 0.050
_BETWEEN_RUNS = (0.01, 0.02)
"""Relative scatter of slopes and limits of the beams from run to run (chosen)."""


class GaitRigSettings(BenchSettings):
    """The swimmer, what holds it, and its sliders.

    Attributes
    ----------
    d0_mm, d1_mm, d2_mm, d3_mm
        Distance of the motors, inner link, outer link and fin, as the source's search found them (section 7.5).
    fin_kg_m2, link_kg_m, body_kg
        Masses of fins by area, links by length, and body (chosen). Those of the links count to the body.
    mount_n_m, mount_n_s_m
        Stiffness and damping of the arm across the rail, at the robot. Chosen, as the next two: k_G and b_G of section
        7.3, which the source does not state. Along the rail it is held fast.
    yaw_n_m_rad, yaw_n_m_s
        Of the arm in torsion.
    slider_stuck_at
        The sliders of the beams get no farther than this on their way from long (0) to short (1).
    scatter
        Factor on the scatter of the beams.
    """

    d0_mm: PositiveFloat = 40.0
    d1_mm: PositiveFloat = 112.1
    d2_mm: PositiveFloat = 30.2
    d3_mm: PositiveFloat = 114.2
    fin_kg_m2: PositiveFloat = 1.4
    link_kg_m: NonNegativeFloat = 0.1
    body_kg: PositiveFloat = 1.0
    mount_n_m: PositiveFloat = 1000.0
    mount_n_s_m: NonNegativeFloat = 5.0
    yaw_n_m_rad: PositiveFloat = 0.5
    yaw_n_m_s: NonNegativeFloat = 0.05
    slider_stuck_at: float = Field(default=1.0, ge=0.0, le=1.0)
    scatter: NonNegativeFloat = 1.0


class GaitRig(Bench):
    """Load of a swimmer of two fins on the arm that holds it in the water.

    Physics: see `equations`. The arm yields across the rail and in torsion, so that one fin feels what the other does;
    the water carries nothing from fin to fin. Joints: ``fin_1`` (left) and ``fin_2``, angles of the servos' shafts,
    positive to the front; ``slider``, 0 where the springs hold the beams long, 1 where the tendon has made them short.

    Signals: ``force_x``, ``force_y`` (N), ``torque_z`` (N m) on the sensor, x along the rail to the front, z up;
    ``fin_1``, ``fin_2`` (rad); ``slider``.
    """

    Settings: ClassVar[type[BenchSettings]] = GaitRigSettings
    step_s = 0.0005  # light plates in water: drag stops them within a millisecond
    steps_are_beyond_model = True
    scale = _SCALE
    joints = (*_FINS, "slider")
    sensed = _FELT
    remembered = ("factors", "short", "shaft_before", "servo", "stepper")
    signals: Mapping[str, str] = {
        "force_x": "N", "force_y": "N", "torque_z": "N m", "fin_1": "rad", "fin_2": "rad", "slider": "1",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._servo = self._passage(_FINS)
        self._shaft_before = np.zeros((1, 2))
        spread = 0.0 if self._settings.as_modelled else self._settings.scatter * self._settings.noise
        self._set_up(1.0 + spread * np.array(_BETWEEN_RUNS) * rng.standard_normal(2), short=False)

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, which beam it stands on, and hidden effects."""
        beam = "short" if self._short else "long"
        return self._truth((*self._at_fins, *self._servo.effects), beam=beam)

    def _set_up(self, factors: FloatArray, *, short: bool) -> None:
        self._factors, self._short = factors, short
        model = swimmer(self._settings, short=short)
        nominal = model.named_values
        scattered = {
            name: nominal[name] * factors[1 if name.endswith("limit") else 0] for name in _OF_THE_BEAM
        }
        self._model: Model = self._with_errors(model.with_values(scattered))
        at_fins = [hidden for hidden in self._settings.hide if hidden.site not in self.joints]
        self._at_fins = hidden_effects(at_fins, self._model, _SCALE)
        self._stepper = Stepper(self._model, effects=self._at_fins, step_s=self.step_s)
        names = [output.name for output in self._model.outputs]
        self._outputs = [names.index(name) for name in _FELT]

    def _advance(self, time_s: FloatArray) -> FloatArray:
        shaft = self._servo(np.column_stack([self._drives[fin].angles(time_s) for fin in _FINS]))
        slider = np.minimum(self._drives["slider"].angles(time_s), self._settings.slider_stuck_at)
        short = slider > 0.5
        turns = np.flatnonzero(np.diff(short, prepend=self._short))
        loads = []
        for begin, end in zip([0, *turns], [*turns, len(short)], strict=True):
            if begin == end:
                continue
            self._slide(short=bool(short[begin]))
            edges = np.concatenate([self._shaft_before, shaft[begin:end]])
            self._shaft_before = shaft[end - 1 : end].copy()
            loads.append(self._stepper.advance(edges)[:, self._outputs])
        require_finite(self._stepper, "swimmer")
        return np.column_stack([np.concatenate(loads), shaft, slider])

    def _slide(self, *, short: bool) -> None:
        """Change the beams; whatever moves goes on moving."""
        if short != self._short:
            before = self._stepper.snapshot()
            self._set_up(self._factors, short=short)
            self._stepper.restore(before)

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._set_up(unpacked(memory["factors"]), short=memory["short"])
        super()._recall(memory)


def swimmer(settings: GaitRigSettings, *, short: bool) -> Model:
    """Return the model of the swimmer on its arm, behind servos that follow their shafts at 30 Hz (chosen).

    `settings`: its dimensions, masses and mount. `short`: whether the tendon has made the beams short.
    """
    keys = settings
    links_m = 1e-3 * (keys.d1_mm + keys.d2_mm)
    fin_m, body_m = 1e-3 * keys.d3_mm, 1e-3 * keys.d0_mm
    values = {
        "link": 1e-3 * keys.d1_mm,
        "arm": 1e-3 * (keys.d2_mm + 0.5 * keys.d3_mm),
        "plate_area": _FIN_WIDTH_M * fin_m,
        "plate_mass": keys.fin_kg_m2 * _FIN_WIDTH_M * fin_m,
        "added_mass": 0.0,
        "motor_spacing": body_m,
        "body_mass": keys.body_kg + 2.0 * keys.link_kg_m * links_m,
        "body_area": 2.0 * _BODY_WIDTH_M * body_m,
        "mount_stiffness": keys.mount_n_m,
        "mount_damping": keys.mount_n_s_m,
        "yaw_stiffness": keys.yaw_n_m_rad,
        "yaw_damping": keys.yaw_n_m_s,
        "servo_frequency": 30.0,
        "servo_damping": 1.0,
    }
    if short:
        values |= dict(zip(_OF_THE_BEAM, SHORT_BEAM, strict=True))
    return fin_model("gait-rig", fins=2, free=("y", "yaw")).with_values(values)
