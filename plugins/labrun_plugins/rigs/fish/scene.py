"""The fish with two pectoral five-bars and a tail, on an arm that can tow it (section 6 of the source work).

What the water of the fish's tank adds to the loads on its fins: body drag, waves, vortices.

Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import PositiveFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.models import Input, Model, Output, Parameter, Site, Stepper, natives
from labrun_plugins.rigs.fish.fins import ATTACHMENTS, JOINTS, WATERS, AttachmentName, fin_loads, motion_at
from labrun_plugins.rigs.fish.free_scene import chosen_by_hand
from labrun_plugins.simulated.bench import BenchSettings, TowedBench, hidden_effects, require_finite

# First sloshing modes of water 0.5 m deep in the 1.22 x 0.61 m tank: omega^2 = g k tanh(k h), k = pi / length.
_ALONG = 4.66
_ACROSS = 7.07
_WAVE_DAMPING = 0.03
_STIRRING_S = 2.0
_VORTEX_S = 2.0
_VORTEX_LONG_M = 0.15
_FOLLOWS_S = 0.02

STATES = (
    "stirring",
    "wave_x",
    "wave_x_rate",
    "wave_y",
    "wave_y_rate",
    "vortex_x",
    "vortex_y",
    "vortex_yaw",
    "going",
)
_INPUTS = (
    "fin_force_x", "fin_force_y", "fin_force_z", "fin_torque_x", "fin_torque_y", "fin_torque_z", "fin_size",
    "speed", "acceleration", "noise_x", "noise_y", "noise_yaw",
)  # fmt: skip
OUTPUTS = (
    Output("force_x", "N"), Output("force_y", "N"), Output("force_z", "N"),
    Output("torque_x", "N m"), Output("torque_y", "N m"), Output("torque_z", "N m"),
)  # fmt: skip


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Rates of the states: how much the water is stirred, waves along and across the tank, vortices, the speed."""
    dx[0] = (u[6] - x[0]) / _STIRRING_S
    dx[1] = x[2]
    dx[2] = _ALONG * _ALONG * (u[0] - x[1]) - 2.0 * _WAVE_DAMPING * _ALONG * x[2]
    dx[3] = x[4]
    dx[4] = _ACROSS * _ACROSS * (u[1] - x[3]) - 2.0 * _WAVE_DAMPING * _ACROSS * x[4]
    strength = math.sqrt(2.0 / _VORTEX_S) * x[0]
    # Vortices die out, and a fish that is towed leaves them behind after the length of the water around its fins.
    fading = 1.0 / _VORTEX_S + abs(u[7]) / _VORTEX_LONG_M
    dx[5] = p[3] * strength * u[9] - fading * x[5]
    dx[6] = p[3] * strength * u[10] - fading * x[6]
    dx[7] = p[4] * strength * u[11] - fading * x[7]
    # The carriage's speed as a state, so that what sits at the fish feels its acceleration; held to it against drift.
    dx[8] = u[8] + (u[7] - x[8]) / _FOLLOWS_S


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Wrench at the sensor, which sits p[5] above the body's centre."""
    drag = p[0] * u[7] * abs(u[7])
    y[0] = u[0] - drag - p[1] * u[8] + p[2] * x[1] + x[5] + force[0]
    y[1] = u[1] + p[2] * x[3] + x[6]
    y[2] = u[2]
    # From the body's origin to the sensor: r = (0, 0, -height), torque + r x force.
    y[3] = u[3] + p[5] * y[1]
    y[4] = u[4] - p[5] * y[0]
    y[5] = u[5] + x[7]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``fish``: a body that moves through the water at the carriage's speed."""
    values[0] = 0.0
    values[1] = x[8]
    values[2] = 0.0
    values[3] = 0.0


def fire_model(mount_height_m: float) -> Model:
    """Return the model of the tank around the fins.

    The drag of body and mount, 1.68 N s^2/m^2, is what is left of the 1.5 N that the source measured, summed over
    0.1, 0.3 and 0.6 m/s, in the pose of least drag (E6.g), after that of the fins' edges and struts in it. The rest is
    chosen: mass 2 kg with what water it drags along, waves that return 3 % of the force, vortices of 4 % of
    the fins' mean force, and 4.5 mm times it in yaw.
    """
    return Model(
        name="fire-tank",
        states=STATES,
        inputs=tuple(Input(name) for name in _INPUTS),
        outputs=OUTPUTS,
        parameters=(
            Parameter("body_drag", 1.68, unit="N s^2/m^2"),
            Parameter("mass", 2.0, unit="kg"),
            Parameter("waves", 0.03),
            Parameter("vortices", 0.04),
            Parameter("yaw_vortices", 0.0045, unit="m"),
            Parameter("mount_height", mount_height_m, unit="m"),
        ),
        sites=(Site("fish", "body", coordinate="0", rate="going"),),
        initial=dict.fromkeys(STATES, 0.0),
        **natives(derivative, output, site_values),
        source="simulated fire tank",
    )


_SCALE = Scale(coordinate=0.5, rate=0.2, acceleration=1.0, force=0.3, signal=0.5, time_s=2.0)


class FireTankSettings(BenchSettings):
    """`mount_height_m`: the sensor sits this far above the fish's centre, at the end of the arm.

    `attachment`: the blades of the pectoral fins, where no condition says otherwise.
    """

    mount_height_m: PositiveFloat = 0.15
    attachment: AttachmentName = "broad"


class FireTank(TowedBench):
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
    remembered = ("attachment", "carriage", "motion", "wake", "inputs_before", "servo", "stepper")
    signals: Mapping[str, str] = {
        **{one.name: one.unit for one in OUTPUTS}, "position": "m", **dict.fromkeys(JOINTS, "rad"),
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._model = self._with_errors(fire_model(self._settings.mount_height_m))
        in_water = [one for one in self._settings.hide if one.site not in self.joints]
        water_effects = hidden_effects(in_water, self._model, _SCALE)
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
