"""A rigid body that swings on a polyester hinge, watched by motion capture (section 3 of the source work).

Its equation of motion, eq. (3.5) with the gravity term corrected, stands in ``bench.toml``.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale, load_effect
from labrun.errors import ExperimentError
from labrun.models import Model, Site, Stepper, load_model
from labrun_plugins.rigs.hinge.dimensions import damping, stiffness
from labrun_plugins.simulated.bench import (
    Bench,
    BenchSettings,
    described,
    hidden_effects,
    model_beside,
    require_finite,
)

_PIVOT_M = (0.2, 0.0, 1.1)
_GRAVITY_M_S2 = 9.81
_AIR_KG_M3 = 1.2
_ORDINARY_RAD = math.radians(20.0)
"""Amplitude at which linear damping and quadratic drag together damp as the map's b does."""
_BETWEEN_SETUPS = (0.023, 0.0315)
_BETWEEN_RELEASES = (0.001, 0.005)
"""Relative scatter of stiffness and damping; together 2.3 % and 3.2 %, as in Table 3.2."""
_REMEMBERED_RELEASES = 200
_SCALE = Scale(coordinate=0.7, rate=15.0, acceleration=300.0, force=0.015, signal=0.7, time_s=0.05)


class HingeBenchSettings(BenchSettings):
    """The specimen and the body it carries.

    The source gives neither: chosen are the specimen its maps agree on best, and an acrylic plate of 50 x 86
    x 3 mm, which weighs 15.4 g.

    Attributes
    ----------
    width_mm, length_mm, area_cm2
        Hinge width and length, and the body's area; a condition of the same name changes the specimen.
    body_width_mm, areal_density_kg_m2
        The body is a flat plate of this width, as high as its area asks for; it begins half a hinge's length
        below the hinge's middle.
    drag_coefficient
        Of the plate broadside on, for the part of the air's drag that grows with the square of speed. A plate
        that is towed has about 2; the default is less, since the map's b has most of the air's drag in it.
    scatter
        Factor on the scatter of stiffness and damping.
    stiffness_n_m_rad, damping_n_m_s_rad
        Of a specimen that the maps do not hold for, such as that of Table 3.2.
    between_tests
        Relative scatter (sd) of stiffness and damping between tests of one mounting, minutes apart; another value of
        the condition ``test`` begins another test. It then takes the place of the scatter between setups, from which
        Table 3.2 does not tell it.
    model
        A model file that the bench is, in place of a specimen: one that a diagnosis saved, say.
    """

    width_mm: PositiveFloat = 50.0
    length_mm: PositiveFloat = 1.75
    area_cm2: PositiveFloat = 43.0
    body_width_mm: PositiveFloat = 50.0
    areal_density_kg_m2: PositiveFloat = 3.58
    drag_coefficient: NonNegativeFloat = 0.4
    scatter: NonNegativeFloat = 1.0
    stiffness_n_m_rad: PositiveFloat | None = None
    damping_n_m_s_rad: PositiveFloat | None = None
    between_tests: tuple[NonNegativeFloat, NonNegativeFloat] | None = None
    model: str | None = None


def _swinging(name: str) -> Model:
    """Return a model that can stand for this bench: a body that swings freely on one joint, ``hinge``."""
    model = load_model(name)
    outputs = [output.name for output in model.outputs]
    if model.inputs or model.states != ("angle", "rate") or outputs != ["angle"]:
        raise ExperimentError(
            f"rig.scene.model: model {model.name} ({name}) cannot be the hinge bench, "
            "which has the states angle and rate, the output angle, and no input",
            hint="name a model like experiments/models/hinge-pendulum.toml, or what labrun gap diagnose saved from it",
        )
    return model


class HingeBench(Bench):
    """The hinge pendulum: corrected eq. (3.5), k and b from the corrected maps, and air drag.

    The maps are (3.12) and (3.11). The map's b is the total damping that the source measured, of material and
    air (``b = b_m + b_a``), at whatever amplitude. Air drag proper grows with the square of speed: ``1/2 rho C_d``
    integrated along the plate. So that it is not counted twice, the linear damping is the map's b less what this
    drag amounts to in a swing of 20 degrees, ``8 / (3 pi) c omega A`` (equal loss per cycle; both chosen). Larger
    swings are damped a little more than the map says, smaller ones a little less; a linear fit sees the difference
    in its residual, and hardly in b.

    Stiffness and damping scatter as in Table 3.2. Chosen: nearly all of it is between setups, and 0.1 % and 0.5 % is
    left between the releases of one. A run begins with one setup, and every change of specimen makes another: a
    specimen that is taken off and comes back later is mounted anew.

    With `as_modelled` there is no air drag but what the map's b contains, and the bench is what eq. (3.5) says.
    With `model`, a file such as a diagnosis saves, the bench is that model, with the effects it carries, and nothing of
    it scatters.

    The joint ``hinge`` is held while a command for it runs, and free when it has ended.

    Signals: ``arm_x`` ... ``arm_qw``, pose of the body in the room (m; unit quaternion; the hinge axis is y,
    the pivot at (0.2, 0, 1.1) m), and ``hinge``, its angle from hanging straight down (rad).
    """

    Settings: ClassVar[type[BenchSettings]] = HingeBenchSettings
    step_s = 0.001
    scale = _SCALE
    joints = ("hinge",)
    sensed = ("angle",)
    shown_by: ClassVar[Mapping[str, str]] = {"angle": "hinge"}
    """By which signal an output of a model shows that is called otherwise."""
    remembered = ("specimen", "setup_scale", "test", "scales", "held", "releases", "sight", "stepper")
    signals: Mapping[str, str] = {
        "arm_x": "m", "arm_y": "m", "arm_z": "m", "arm_qx": "1", "arm_qy": "1", "arm_qz": "1", "arm_qw": "1",
        "hinge": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        scatter = self._settings.scatter * self._settings.noise
        between_tests = self._settings.between_tests
        self._test_sd = scatter * np.array(between_tests or (0.0, 0.0))
        self._setup_sd = scatter * np.array(_BETWEEN_SETUPS if between_tests is None else (0.0, 0.0))
        self._test: float | str | None = None
        self._release_sd = scatter * np.array(_BETWEEN_RELEASES)
        self._setup_scale = 1.0 + self._setup_sd * rng.standard_normal(2)
        self._scales = self._setup_scale.copy()
        self._releases: list[list[float]] = []
        self._held = False
        self._specimen: dict[str, float] = {}
        # What is sensed is the angle however it came about: effects there see the body held as well as swinging.
        self._sight = self._passage(self.sensed)
        self._put({name: getattr(self._settings, name) for name in ("width_mm", "length_mm", "area_cm2")})

    @property
    def places(self) -> tuple[Site, ...]:
        """Where effects can be hidden: the hinge, and the angle as it is seen; nothing drives it."""
        return (*self._model.sites, *(Site(signal, "output") for signal in self.sensed))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Mount another specimen where the condition names another ``width_mm``, ``length_mm`` or ``area_cm2``.

        Another ``test`` of the same specimen differs as tests do minutes apart.
        """
        wanted = {name: float(condition.get(name, size)) for name, size in self._specimen.items()}
        if wanted != self._specimen:
            state = self._stepper.state
            self._put(wanted)
            self._stepper.state = state
            self._setup_scale = self._mounted()
            self._scales = self._setup_scale.copy()
        test = condition.get("test", self._test)
        if self._settings.between_tests is not None and test != self._test:
            self._test = test
            self._setup_scale = 1.0 + self._test_sd * self._rng.standard_normal(2)

    def truth(self) -> dict[str, Any]:
        """Return specimen, parameters as they are on the bench, drag, and hidden effects.

        ``parameters`` are those of the present setup; ``releases`` gives time (s), stiffness and damping of each of
        the latest 200 releases, whatever specimen it was of.
        """
        values = self._model.named_values
        if self._settings.model is None:
            values["stiffness"] *= float(self._setup_scale[0])
            values["damping"] *= float(self._setup_scale[1])
        return {
            "specimen": dict(self._specimen),
            "parameters": values,
            "releases": [{"time_s": time_s, "stiffness": k, "damping": b} for time_s, k, b in self._releases],
            "parameter_errors": dict(self._settings.parameters),
            "built_in": [described(self._drag)],
            "hidden": [described(effect) for effect in (*self._hidden, *self._sight.effects)],
        }

    def _mounted(self) -> FloatArray:
        """Return the factors on stiffness and damping that one mounting of the specimen has.

        The specimen is part of the seed: runs of other specimens with one seed must not share their scatter.
        """
        nanometres = (round(1e6 * size) for size in self._specimen.values())
        rng = np.random.default_rng((int(self._rng.integers(2**63)), *nanometres))
        factors: FloatArray = 1.0 + self._setup_sd * rng.standard_normal(2)
        return factors

    def _put(self, specimen: dict[str, float]) -> None:
        width_m, length_m = specimen["width_mm"] * 1e-3, specimen["length_mm"] * 1e-3
        area_m2, body_width_m = specimen["area_cm2"] * 1e-4, self._settings.body_width_mm * 1e-3
        height_m = area_m2 / body_width_m
        mass_kg = self._settings.areal_density_kg_m2 * area_m2
        self._lever_m = (height_m + length_m) / 2
        k = self._settings.stiffness_n_m_rad or stiffness(width_m, length_m)
        inertia = mass_kg * (height_m**2 / 12 + self._lever_m**2)
        gravity = mass_kg * _GRAVITY_M_S2 * self._lever_m
        coefficient = 0.0 if self._settings.as_modelled else self._settings.drag_coefficient
        drag = 0.5 * _AIR_KG_M3 * coefficient * body_width_m * height_m**4 / 4
        speed_rad_s = math.sqrt((k + gravity) / inertia) * _ORDINARY_RAD
        total = self._settings.damping_n_m_s_rad or damping(area_m2, width_m, length_m)
        mounted = {
            "stiffness": k,
            "damping": max(0.0, total - 8.0 / (3.0 * math.pi) * drag * speed_rad_s),
            "inertia": inertia,
            "gravity_torque": gravity,
        }
        model = model_beside(__file__, "bench.toml").with_values(mounted)
        self._specimen = specimen
        if self._settings.model is not None:
            model, drag = _swinging(self._settings.model), 0.0
        self._model = self._with_errors(model)
        self._drag = load_effect("quadratic-drag").attach("hinge", coefficient=drag)
        at_hinge = [hidden for hidden in self._settings.hide if hidden.site not in self.sensed]
        self._hidden = hidden_effects(at_hinge, self._model, _SCALE)
        self._stepper = Stepper(self._model, effects=[self._drag, *self._hidden], step_s=self.step_s)

    def _advance(self, time_s: FloatArray) -> FloatArray:
        drive = self._drives["hinge"]
        held = drive.under_way(time_s) > 0
        commanded = drive.angles(time_s)
        angle = np.empty(len(time_s))
        edges = np.flatnonzero(np.diff(held)) + 1
        for first, last in zip([0, *edges], [*edges, len(time_s)], strict=True):
            if held[first]:
                angle[first:last] = commanded[first:last]
                self._stepper.state = (commanded[last - 1], 0.0)
            else:
                if self._held and self._settings.model is None:
                    self._scales = self._setup_scale * (1.0 + self._release_sd * self._rng.standard_normal(2))
                    nominal = self._model.named_values
                    k, b = self._scales * (nominal["stiffness"], nominal["damping"])
                    self._releases.append([float(time_s[first]), float(k), float(b)])
                    del self._releases[:-_REMEMBERED_RELEASES]
                scales = self._scales[: len(self._model.inputs)]
                inputs = np.broadcast_to(scales, (last - first + 1, len(scales)))
                angle[first:last] = self._stepper.advance(inputs)[:, 0]
            self._held = bool(held[last - 1])
        require_finite(self._stepper, "hinge bench")
        return self._rows(self._sight(angle))

    def _rows(self, angle: FloatArray) -> FloatArray:
        zero = np.zeros_like(angle)
        return np.column_stack([
            _PIVOT_M[0] - self._lever_m * np.sin(angle),
            zero + _PIVOT_M[1],
            _PIVOT_M[2] - self._lever_m * np.cos(angle),
            zero, np.sin(angle / 2), zero, np.cos(angle / 2),
            angle,
        ])  # fmt: skip

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._put(dict(memory["specimen"]))
        super()._recall(memory)
