"""Logs of arms with the torques that their motions take, by MuJoCo's inverse dynamics of the true arm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from labrun.fit import Dataset, FitTrial
from labrun.gap import RobotDiagnosis
from labrun.gap.diagnosis import Cause
from labrun.gap.robot.torque_diagnosis import diagnose_torques
from labrun.models import load_model, read_robot
from labrun.store import SignalInfo

_AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0")


def arm(joints: int) -> str:
    """Return the MJCF of an arm with motors; one of two joints swings in a plane."""
    axes = ("0 1 0", "0 1 0") if joints == 2 else _AXES[:joints]
    bodies, ends = "", ""
    for number, axis in enumerate(axes):
        mass, length = 4.0 * 0.65**number, 0.3 if number < 3 else 0.12
        text = "0 0 0.1" if number == 0 else f"0 0 {0.3 if number <= 3 else 0.12}"
        across, along = mass * length**2 / 10, mass * length**2 / 40
        bodies += (
            f'<body name="link_{number + 1}" pos="{text}"><joint name="arm_{number + 1}" axis="{axis}"/>'
            f'<inertial pos="{0.01 * (-1) ** number} 0.005 {length / 2}" mass="{mass:.4f}" '
            f'diaginertia="{across:.6f} {across:.6f} {along:.6f}"/>'
        )
        ends += "</body>"
    motors = "".join(f'<motor name="arm_{k + 1}" joint="arm_{k + 1}"/>' for k in range(joints))
    return (
        f'<mujoco model="arm"><compiler angle="radian"/><worldbody>{bodies}{ends}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )


@dataclass(frozen=True)
class Hidden:
    """What the true arm has and the file does not.

    Attributes
    ----------
    force : (q, q') -> (joints,)
        Acts on the joints beside their drives.
    armature : (joints,)
    load
        Mass, and place on the last link.
    masses
        Factors of the links' masses.
    gravity
    units
        Factors of what is logged of the torques.
    amperes
        Places of the joints of which the log states a motor current.
    """

    force: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    armature: Sequence[float] = ()
    load: tuple[float, tuple[float, float, float]] | None = None
    masses: Sequence[float] = ()
    gravity: tuple[float, float, float] | None = None
    units: Sequence[float] = field(default=())
    amperes: Sequence[int] = ()


def diagnosed(
    folder: Path, joints: int, hidden: Hidden, *, seed: int = 0, trials: int = 4, seconds: float = 6.0,
    step_rad: float = 3e-4, noise: float = 0.01,
) -> RobotDiagnosis:  # fmt: skip
    """Diagnose a log at 100 Hz with encoder steps and white noise of the torques, both as a part of nothing known."""
    spec = mujoco.MjSpec.from_string(arm(joints))
    if hidden.load is not None:
        ball = spec.bodies[-1].add_body(pos=hidden.load[1])
        ball.mass, ball.ipos, ball.inertia, ball.explicitinertial = (
            hidden.load[0],
            [0, 0, 0],
            [1e-9] * 3,
            True,
        )
    true = spec.compile()
    for number, factor in enumerate(hidden.masses):
        true.body_mass[number + 1] *= factor
        true.body_inertia[number + 1] *= factor
    if hidden.armature:
        true.dof_armature[:] = hidden.armature
    if hidden.gravity is not None:
        true.opt.gravity[:] = hidden.gravity
    rng, data = np.random.default_rng(seed), mujoco.MjData(true)
    time_s = np.arange(int(100 * seconds)) / 100
    made = []
    for number in range(trials):
        w, phase = 2 * np.pi * rng.uniform(0.1, 0.8, (joints, 3)), rng.uniform(0, 6, (joints, 3))
        turn = w * time_s[:, None, None] + phase
        q, rate = (0.35 * np.sin(turn)).sum(2), (0.35 * w * np.cos(turn)).sum(2)
        acceleration = (-0.35 * w**2 * np.sin(turn)).sum(2)
        torque = np.empty_like(q)
        for row in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[row], rate[row], acceleration[row]
            mujoco.mj_inverse(true, data)
            torque[row] = data.qfrc_inverse
        if hidden.force is not None:
            torque -= hidden.force(q, rate)
        torque += noise * rng.standard_normal(torque.shape)
        if hidden.units:
            torque *= hidden.units
        measured = np.round(q / step_rad) * step_rad
        made.append(FitTrial(f"trial {number}", {"motion": f"m{number}"}, 1, time_s, torque, measured))
    file = folder / "arm.xml"
    file.write_text(arm(joints), encoding="utf-8")
    robot, model = read_robot(file), load_model(file)
    inputs = tuple(
        SignalInfo(signal.name, "A" if index in hidden.amperes else signal.unit, "linear")
        for index, signal in enumerate(model.inputs)
    )
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    dataset = Dataset("arm", folder, "recording", inputs, outputs, tuple(made))
    return diagnose_torques(robot, model, dataset)


def causes_of(diagnosis: RobotDiagnosis) -> dict[tuple[str, str], Cause]:
    """Return all causes by effect and site."""
    every = [
        *diagnosis.whole_causes,
        *(cause for joint in diagnosis.joints for cause in joint.diagnosis.causes),
    ]
    return {(cause.name.effect, cause.name.site): cause for cause in every}
