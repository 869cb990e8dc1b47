"""The gait rig with its carriage free: a swimmer of two fins that runs on a rail above a tank (section 7.6).

The rail holds the swimmer on its course; along it nothing does but friction. A line can pull the carriage back
(`tow`), and never pushes it. While it pulls, the fins go on, and the water takes no notice of the way (chosen: nobody
measures then).
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.models import Model, Stepper
from labrun_plugins.rigs.buckling_fin.swimmers import LINK_DAMPING, LINK_HZ, two_fin_swimmer
from labrun_plugins.rigs.buckling_fin.wing_scene import POSE, poses
from labrun_plugins.simulated.bench import Bench, BenchSettings, HiddenEffect, hidden_effects, require_finite

_SCALE = Scale(coordinate=0.5, rate=0.3, acceleration=3.0, force=1.0, signal=0.5, time_s=2.0)
_X, _SPEED = 0, 3
_LINKS = {"servo_frequency": LINK_HZ, "servo_damping": LINK_DAMPING}
_SENSOR_SD_N = 0.02
"""Of what the water does to the sensor at random (chosen)."""


class RailRigSettings(BenchSettings):
    """Which swimmer hangs there, and what it hangs on.

    Attributes
    ----------
    design
        Parameters of the swimmer, SI, as its design has them; see `equations.PARAMETERS`.
    rail_n, rail_at_rest_n
        Friction of the rail in motion and at rest, N (chosen; the source blames friction and stiction of the rail for
        its stop-and-go, and gives neither).
    carriage_kg
        What of the body's mass is above the sensor (chosen).
    rail
        "locked" holds the carriage where it is.
    ends_m
        Where the rail's bumpers are, from the carriage's start.
    """

    design: dict[str, float] = Field(default_factory=dict)
    rail_n: NonNegativeFloat = 0.3
    rail_at_rest_n: NonNegativeFloat = 0.6
    carriage_kg: PositiveFloat = 0.3
    rail: Literal["free", "locked"] = "free"
    ends_m: tuple[float, float] = (-0.1, 1.0)

    @model_validator(mode="after")
    def _rests(self) -> "RailRigSettings":
        if self.rail_at_rest_n < self.rail_n:
            raise ValueError(f"rail_at_rest_n = {self.rail_at_rest_n:g} is below rail_n = {self.rail_n:g}")
        if self.rail_n == 0 < self.rail_at_rest_n:
            raise ValueError(
                f"rail_at_rest_n = {self.rail_at_rest_n:g} needs some friction in motion: rail_n > 0"
            )
        if not self.ends_m[0] < 0.0 < self.ends_m[1]:
            raise ValueError("ends_m: the carriage's start, 0, is between them")
        return self


class RailRig(Bench):
    """A swimmer under a free carriage: where it is, and what it does to the carriage.

    Joints ``left`` and ``right`` are the servos, positive towards the front. Signals: ``force_x``, ``force_y`` (N),
    ``torque_z`` (N m) and zeros for the rest of a wrench, of the swimmer on the carriage, x forward; ``swimmer_x`` ...
    ``swimmer_qw``, its pose (m; unit quaternion), and likewise ``link_x`` ... and ``plate_x`` ..., of both parts of
    the left fin, whose markers stand on masts; ``position`` of the carriage (m); each servo's angle (rad).

    With `as_modelled` the rail has no friction.
    """

    Settings: ClassVar[type[BenchSettings]] = RailRigSettings
    step_s = 0.001
    steps_are_beyond_model = True
    scale = _SCALE
    joints = ("left", "right")
    sensed = ("x",)
    remembered = ("pull", "servo_before", "servo", "free", "held")
    signals: Mapping[str, str] = {
        **{f"force_{axis}": "N" for axis in "xyz"}, **{f"torque_{axis}": "N m" for axis in "xyz"},
        **{f"{part}_{quantity}": "m" if quantity in "xyz" else "1" for part in ("swimmer", "link", "plate")
            for quantity in POSE},
        "position": "m", "left": "rad", "right": "rad",
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        keys = self._settings
        self._model: Model = self._with_errors(two_fin_swimmer().with_values({**_LINKS, **keys.design}))
        on_swimmer = [hidden for hidden in keys.hide if hidden.site not in self.joints]
        self._servo = self._passage(self.joints)
        rubs = keys.rail_at_rest_n > 0 and not keys.as_modelled
        self._rail = hidden_effects([_friction(keys)], self._model, _SCALE) if rubs else []
        swimmer_effects = hidden_effects(on_swimmer, self._model, _SCALE)
        self._hidden = swimmer_effects + self._servo.effects
        self._free = Stepper(self._model, effects=[*self._rail, *swimmer_effects], step_s=self.step_s)
        values = self._model.named_values
        held = two_fin_swimmer(held=True).with_values(values)
        on_held = [effect for effect in swimmer_effects if effect.site != "rail"]
        self._held = Stepper(held, effects=on_held, step_s=self.step_s)
        self._outputs = [output.name for output in self._model.outputs]
        self._lengths_m = (values["link"], values["arm"])
        self._spacing_m = values["motor_spacing"]
        self._pull: tuple[float, float, float] | None = None  # to_m, speed_m_s, start_s
        self._servo_before = np.zeros((1, 2))

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float) -> None:  # noqa: ARG002
        """Pull the carriage to `to_m` from `start_s` on, from where it is then; a line does not push."""
        self._pull = (to_m, speed_m_s, start_s) if speed_m_s > 0 else None

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects, of which the rail's friction is one."""
        return self._truth((*self._rail, *self._hidden))

    def _advance(self, time_s: FloatArray) -> FloatArray:
        goals_rad = np.column_stack([self._drives[joint].angles(time_s) for joint in self.joints])
        edges = np.concatenate([self._servo_before, self._servo(goals_rad)])
        self._servo_before = edges[-1:].copy()
        rows = np.empty((len(time_s), len(self._outputs)))
        first = 0
        while first < len(time_s):
            first = self._stretch(time_s, edges, first, rows)
        require_finite(self._free, "swimmer")
        return self._signals(rows, goals_rad)

    def _stretch(self, time_s: FloatArray, edges: FloatArray, first: int, rows: FloatArray) -> int:
        """Simulate up to where the line gets taut or slack, or to the end; return where that is."""
        count = len(time_s)
        if self._settings.rail == "locked":
            self._locked(edges, first, count, rows, np.full(count - first, self._free.state[_X]))
            return count
        if self._pull is not None:
            to_m, speed, start_s = self._pull
            begins = int(np.searchsorted(time_s, start_s))
            if begins > first:
                return self._freely(edges, first, min(begins, count), rows)
            here = self._free.state[_X]
            if here > to_m:
                steps = int(np.ceil((here - to_m) / (speed * self.step_s)))
                end = min(count, first + steps)
                way = np.maximum(here - speed * self.step_s * np.arange(1, end - first + 1), to_m)
                self._locked(edges, first, end, rows, way)
                return end
            self._pull = None
        return self._freely(edges, first, count, rows)

    def _freely(self, edges: FloatArray, first: int, end: int, rows: FloatArray) -> int:
        """Swim; a bumper stops the carriage for good, until it is pulled back."""
        low, high = self._settings.ends_m
        states = self._free.advance(edges[first : end + 1])
        rows[first:end] = states
        x = states[:, self._outputs.index("x")]
        if not (beyond := (x < low) | (x > high)).any():
            return end
        state = self._free.state
        state[_X], state[_SPEED] = np.clip(state[_X], low, high), 0.0
        self._free.state = state
        at = int(np.argmax(beyond))
        rows[first + at : end, self._outputs.index("x")] = np.clip(x[at], low, high)
        rows[first + at : end, self._outputs.index("acceleration")] = 0.0
        return end

    def _locked(self, edges: FloatArray, first: int, end: int, rows: FloatArray, x_m: FloatArray) -> None:
        """Move the fins while something else holds or moves the carriage."""
        state = self._free.state
        still = state.copy()
        still[_X] = still[_SPEED] = 0.0
        self._held.state = still
        states = self._held.advance(edges[first : end + 1])
        after = self._held.state
        after[_X], after[_SPEED] = x_m[-1], 0.0
        self._free.state = after
        rows[first:end] = states
        rows[first:end, self._outputs.index("x")] = x_m

    def _signals(self, rows: FloatArray, goals_rad: FloatArray) -> FloatArray:
        names = self._outputs
        x, acceleration = rows[:, names.index("x")], rows[:, names.index("acceleration")]
        zero = np.zeros(len(rows))
        base = rows[:, names.index("base_1")]
        link, plate = poses(base, base + rows[:, names.index("bend_1")], *self._lengths_m)
        side = np.array([0.0, 0.5 * self._spacing_m, 0.0])
        for part in (link, plate):
            part[:, :3] += side + np.column_stack([x, zero, zero])
        force_x = rows[:, names.index("force_x")]
        if self._settings.rail == "free":
            force_x = force_x + self._settings.carriage_kg * acceleration - rows[:, names.index("rail_force")]
        noise = self._settings.noise * _SENSOR_SD_N * self._rng.standard_normal((len(rows), 2))
        return np.column_stack([
            force_x + noise[:, 0], rows[:, names.index("force_y")] + noise[:, 1], zero,
            zero, zero, rows[:, names.index("torque_z")],
            x, zero, zero, zero, zero, zero, np.ones(len(rows)), link, plate,
            x, goals_rad,
        ])  # fmt: skip


def _friction(settings: RailRigSettings) -> HiddenEffect:
    """Return the rail's friction: more at rest than in motion, which makes a slow swimmer stop and go."""
    values = {
        "torque": settings.rail_n,
        "static_excess": settings.rail_at_rest_n / settings.rail_n - 1.0,
        "stribeck_speed": 0.02,
        "transition_speed": 0.002,
    }
    return HiddenEffect(effect="stribeck-friction", site="rail", kind="joint", values=values)
