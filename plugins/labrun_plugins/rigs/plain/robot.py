"""A bench from an MJCF or URDF file: its joints are driven, its bodies are seen, its sensors are felt."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from labrun.devices import FloatArray
from labrun.effects import Scale
from labrun.errors import ExperimentError, ModelError, SpecError
from labrun.models import Model, Robot, Stepper, parse_model, read_robot, robot_table
from labrun_plugins.simulated.bench import Bench, BenchSettings, hidden_effects

_AXES = ("x", "y", "z")
_POSE = (*((axis, f"position[{index}]", "m") for index, axis in enumerate(_AXES)),
         *((part, f"orientation[{index}]", "1") for index, part in enumerate(("qw", "qx", "qy", "qz"))))  # fmt: skip

_LEAD_S = 0.2
_NUDGE = 1e-6
_LEAST_STEP_S = 2e-5


class RobotSettings(BenchSettings):
    """Which robot.

    Attributes
    ----------
    model
        An MJCF or URDF file, from the folder of the experiment; a run keeps its content.
    """

    model: str


class RobotBench(Bench):
    """A robot whose joints get their commands as goals of its actuators; a joint without one gets a position servo.

    Signals: each hinge (rad) and slide (m) by its name, the pose of each named body (``<body>_x`` ... ``<body>_qw``),
    and what its force and torque sensors feel (``force_x`` ... of the first of each, as a force/torque sensor has it).
    Contacts are off. Effects are hidden at its joints, inputs and outputs.
    """

    Settings: ClassVar[type[BenchSettings]] = RobotSettings
    step_s = 0.001
    remembered = ("before", "stepper")
    scale = Scale(coordinate=0.5, rate=2.0, acceleration=20.0, force=1.0, signal=0.5, time_s=1.0)

    @classmethod
    def embed(cls, keys: Mapping[str, Any], find: Callable[[str], Path]) -> dict[str, Any]:
        """Return the settings with the robot itself in the place of its file's name.

        Raises SpecError: the file is not there, or MuJoCo cannot read it.
        """
        model = keys.get("model", "")
        if not isinstance(model, str) or model.lstrip().startswith("<"):
            return dict(keys)
        try:
            return {**keys, "model": read_robot(find(model), "undriven").xml}
        except ModelError as error:
            raise SpecError(str(error.args[0]), hint=error.hint) from None

    def __init__(self, settings: Mapping[str, Any], rng: np.random.Generator) -> None:
        robot = _robot(str(settings.get("model", "")))
        shown = _shown(robot)
        bare = parse_model(robot_table(robot, shown=shown), f"{robot.name}.toml")
        joints = {joint.name: joint for joint in robot.joints}
        driven = [
            actuator for actuator in robot.actuators if actuator.command == "position" and actuator.joint
        ]
        self._driven = [
            [actuator.input for actuator in robot.actuators].index(actuator.input) for actuator in driven
        ]
        self.joints = tuple(actuator.joint for actuator in driven)
        self.signals = {
            **{name: joint.unit for name, joint in joints.items()}, **{name: unit for name, (_, unit) in shown.items()},
        }  # fmt: skip
        self.step_s = _stable_step_s(bare)
        super().__init__(settings, rng)
        self._model: Model = self._with_errors(bare)
        self._hidden = hidden_effects(self._settings.hide, self._model, self.scale)
        self._stepper = Stepper(self._model, effects=self._hidden, step_s=self.step_s)
        self._before = np.zeros((1, len(self._model.inputs)))

    def truth(self) -> dict[str, Any]:
        """Return parameters as they are on the bench, and hidden effects."""
        return self._truth(self._hidden)

    def _begin(self, time_s: float) -> None:
        # several sensors look at it, and whose clock begins first is open
        super()._begin(max(0.0, time_s - _LEAD_S))

    def _advance(self, time_s: FloatArray) -> FloatArray:
        inputs = np.zeros((len(time_s) + 1, len(self._model.inputs)))
        inputs[0] = self._before
        for joint, column in zip(self.joints, self._driven, strict=True):
            inputs[1:, column] = self._drives[joint].angles(time_s)
        self._before = inputs[-1:].copy()
        rows = self._stepper.advance(inputs)
        if not self._stepper.finite:
            raise ExperimentError(
                "the simulated robot blew up", hint="look at its gains and inertias, or hide a weaker effect"
            )
        return rows


def _stable_step_s(model: Model) -> float:
    """Return a step at which Runge-Kutta's fourth order is stable for the stiffest motion near where the robot begins.

    Its region of stability reaches to 2.78 on the negative real axis and to 2.83 on the imaginary one.
    """
    p, count = model.vector(None, {}), len(model.states)
    begin = np.array([rule if isinstance(rule, float) else 0.0 for rule in model.initial.values()])
    u, force = np.zeros(max(1, len(model.inputs))), np.zeros(max(1, len(model.sites)))
    columns = []
    for state in range(count):
        sides = []
        for sign in (1.0, -1.0):
            x, out = begin.copy(), np.zeros(count)
            x[state] += sign * _NUDGE
            model.derivative.python(0.0, x, u, p, force, out)
            sides.append(out)
        columns.append((sides[0] - sides[1]) / (2 * _NUDGE))
    fastest = float(np.abs(np.linalg.eigvals(np.column_stack(columns))).max())
    step_s = min(RobotBench.step_s, 1.5 / max(fastest, 1e-9))
    if step_s < _LEAST_STEP_S:
        raise SpecError(
            f"the robot has a motion that decays or swings within {1e6 / fastest:.2g} us, too stiff to be simulated",
            hint="lower its damping and gains, or give its joints armature",
        )
    return step_s


def _robot(text: str) -> Robot:
    if not text.lstrip().startswith("<"):
        return read_robot(Path(text), "undriven")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        path.write_text(text, encoding="utf-8")
        return read_robot(path, "undriven")


def _shown(robot: Robot) -> dict[str, tuple[str, str]]:
    """Return what is seen and felt besides joints: what of the MJCF model it is, and its unit."""
    channels: dict[str, tuple[str, str]] = {}
    for body in robot.bodies:
        channels |= {f"{body}_{part}": (f"body.{body}.{quantity}", unit) for part, quantity, unit in _POSE}
    for kind, unit in (("force", "N"), ("torque", "N m")):
        for sensor in robot.sensors.get(kind, ())[:1]:
            channels |= {
                f"{kind}_{axis}": (f"sensor.{sensor}[{index}]", unit) for index, axis in enumerate(_AXES)
            }
    return channels
