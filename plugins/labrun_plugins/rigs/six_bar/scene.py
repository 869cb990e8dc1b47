"""The six-bar spherical linkage, held at one hinge by hand and let go, watched by cameras (section 3 of the source)."""

import tomllib
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import tomli_w
from pydantic import NonNegativeFloat

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError
from labrun.models import Model, Site, Stepper, load_model, parse_model, shipped_models
from labrun_plugins.rigs.six_bar.linkage import BODIES, JOINTS, body_turns
from labrun_plugins.simulated.bench import Bench, BenchSettings, Passage, hidden_effects, unpacked

_MODEL = "six-bar"
_HELD = "theta_5"
_CENTRE_M = np.array([0.2, 0.0, 1.1])
_SCALE = Scale(coordinate=0.4, rate=3.0, acceleration=50.0, force=0.01, signal=0.4, time_s=0.4)
_BETWEEN_SETUPS = (0.0094, 0.0131)
"""Relative scatter (sd) of stiffness and damping: that of one hinge by Table 3.2, as it is in the mean of six."""
_GRIP_N_M_RAD = 3.0
_GRIP_N_M_S_RAD = 0.02
_STEADYING_N_M_S_RAD = 0.003
"""A hand: how stiffly it holds the hinge it holds, and how it calms the others (chosen)."""


class SixBarSettings(BenchSettings):
    """What scatters.

    Attributes
    ----------
    scatter
        Factor on the scatter of stiffness and damping between setups.
    """

    scatter: NonNegativeFloat = 1.0


_HAND = (
    f'<general name="hold" joint="{_HELD}" gaintype="affine" gainprm="0 {-_GRIP_N_M_RAD} {-_GRIP_N_M_S_RAD}"/>',
    f'<motor name="pull" joint="{_HELD}" gear="{_GRIP_N_M_RAD}"/>',
    *(
        f'<general name="steady_{joint}" joint="{joint}" gaintype="affine" gainprm="0 0 {-_STEADYING_N_M_S_RAD}"/>'
        for joint in JOINTS
    ),
)
_PULL = 1
"""Which input takes the held hinge to its angle: the grip times that angle, rad; all others are the grip, 0 or 1."""


def _in_hand() -> Model:
    """Return the shipped model with a hand on it: actuators that hold, that pull, and that steady each joint."""
    path = shipped_models()[_MODEL]
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    xml = path.with_name(data["mujoco"]).read_text(encoding="utf-8")
    data["mujoco"] = xml.replace("<equality>", f"<actuator>{''.join(_HAND)}</actuator><equality>")
    names = ["hold", "pull", *(f"steady_{joint}" for joint in JOINTS)]
    data["inputs"] = {name: f"actuator.{name}" for name in names}
    return parse_model(tomli_w.dumps(data), f"{_MODEL} in a hand")


class SixBar(Bench):
    """The linkage of the model ``six-bar``, whose springs and dampers scatter from setup to setup.

    A person holds it at the hinge ``theta_5`` while a command for it runs, which takes the other hinges where springs
    and weights leave them, and lets go when it has ended. A run is one setup.

    Signals: poses ``body_1_x`` ... ``body_6_qw`` (m; unit quaternions; the common point of all hinges is at (0.2, 0,
    1.1) m, the room's axes are those of body 1, which does not move; a body's origin is 60 mm from that point, in the
    middle of its markers), and ``theta_1`` ... ``theta_6`` (rad, 0 when flat).
    """

    Settings: ClassVar[type[BenchSettings]] = SixBarSettings
    step_s = 0.001
    scale = _SCALE
    joints = (_HELD,)
    sensed = JOINTS
    remembered = ("factors", "hand_before", "sight", "stepper")
    signals: Mapping[str, str] = {
        **{f"{body}_{axis}": "m" if axis in "xyz" else "1"
           for body in BODIES for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")},
        **dict.fromkeys(JOINTS, "rad"),
    }  # fmt: skip

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        super().__init__(settings, rng)
        self._nominal = _in_hand()
        self._column = [self._nominal.states.index(joint) for joint in JOINTS]
        loaded = load_model(_MODEL)
        self._rest = loaded.initial_state({})
        in_sight = [
            hidden for hidden in self._settings.hide if hidden.site in self.sensed and hidden.kind == "output"
        ]
        self._sight = Passage(self.sensed, in_sight, _SCALE, self.step_s, self._rest[self._column])
        spread = self._settings.scatter * self._settings.noise * np.array(_BETWEEN_SETUPS)
        self._hand_before = np.array([[0.0, 0.0]])
        self._set_up(np.maximum(1.0 + spread * rng.standard_normal(2), 0.1))

    @property
    def places(self) -> tuple[Site, ...]:
        """Where effects can be hidden: every hinge, and every angle as it is seen."""
        return (*self._model.sites, *(Site(signal, "output") for signal in self.sensed))

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, where it rests, and hidden effects."""
        rest = {joint: float(self._rest[column]) for joint, column in zip(JOINTS, self._column, strict=True)}
        return self._truth((*self._at_hinges, *self._sight.effects), rest_as_documented_rad=rest)

    def _set_up(self, factors: FloatArray) -> None:
        """Take a setup, whose factors on stiffness and damping these are."""
        values = self._nominal.named_values
        scattered = {name: values[name] * factors[k] for k, name in enumerate(("stiffness", "damping"))}
        self._factors = factors
        self._model = self._with_errors(self._nominal.with_values(scattered))
        at_hinges = [
            hidden
            for hidden in self._settings.hide
            if not (hidden.site in self.sensed and hidden.kind == "output")
        ]
        self._at_hinges = hidden_effects(at_hinges, self._model, _SCALE)
        self._stepper = Stepper(
            self._model, effects=self._at_hinges, step_s=self.step_s, initial_state=self._rest
        )

    def _advance(self, time_s: FloatArray) -> FloatArray:
        drive = self._drives[_HELD]
        hand = np.column_stack([np.minimum(drive.under_way(time_s), 1), drive.angles(time_s)])
        # the hand is there or not throughout a step: what it does at the end of one is done from its beginning
        steps = np.repeat(hand[:, None, :], 3, axis=1)  # grip, and the angle that is wanted
        steps[:, 0, 1] = np.append(self._hand_before[0, 1], hand[:-1, 1])
        steps[:, 1, 1] = 0.5 * (steps[:, 0, 1] + steps[:, 2, 1])
        first = np.append(self._hand_before[0, 0], hand[:-1, 0]) == 0
        steps[first, :, 1] = hand[first, None, 1]
        self._hand_before = hand[-1:].copy()
        inputs = np.repeat(steps[:, :, :1], len(self._nominal.inputs), axis=2)
        inputs[:, :, _PULL] *= steps[:, :, 1]
        true = self._stepper.advance(inputs)
        if not self._stepper.finite:
            raise ExperimentError(
                "the simulated six-bar linkage blew up: it came too close to the flat sheet, where it is singular",
                hint="release it nearer to its rest (theta_5 = -9 deg), or hide a weaker effect",
            )
        seen = self._sight(true)
        return np.column_stack([self._poses(seen), seen])

    def _poses(self, seen: FloatArray) -> FloatArray:
        """Return the poses of all bodies, shape (n, 42), from the angles in the order of their names."""
        turns = body_turns(seen)
        poses = []
        for body in BODIES:
            outward = 0.06 * turns[body].apply([1.0, 0.0, 0.0])
            poses += [_CENTRE_M + outward, turns[body].as_quat()]
        return np.column_stack(poses)

    def _recall(self, memory: Mapping[str, Any]) -> None:
        self._set_up(unpacked(memory["factors"]))
        super()._recall(memory)
