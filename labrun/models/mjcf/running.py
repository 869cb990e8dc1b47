"""An MJCF file simulated by MuJoCo alone, in the file's own time steps, along the controls of a log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.models.mjcf.plant import imported


@dataclass(frozen=True)
class Motion:
    """A piece of a log.

    Attributes
    ----------
    time_s : (n,)
    controls : actuator -> (n,)
        By the actuator's name in the file.
    held
        Actuators whose control holds from one sample to the next; the others' controls run linearly.
    position, rate : joint -> value
        How the piece begins.
    """

    time_s: FloatArray
    controls: Mapping[str, FloatArray]
    held: frozenset[str]
    position: Mapping[str, float]
    rate: Mapping[str, float]


def run_mjcf(xml: str, joints: Sequence[str], motions: Sequence[Motion]) -> list[FloatArray]:
    """Return the positions (n, joints) of hinges and slides along pieces of a log; NaN where MuJoCo diverges.

    The file is compiled and stepped as a user of it would: with its integrator, time step, solver and delays.
    """
    model = imported().MjModel.from_xml_string(xml)
    return [_run(model, joints, motion) for motion in motions]


def _run(native: Any, joints: Sequence[str], motion: Motion) -> FloatArray:
    mujoco = imported()
    data = mujoco.MjData(native)
    step_s = float(native.opt.timestep)
    time_s = motion.time_s - motion.time_s[0]
    count = int(np.ceil(time_s[-1] / step_s - 1e-9)) + 1
    grid = step_s * np.arange(count + 1)
    columns = [native.joint(name).qposadr[0] for name in joints]
    for name in joints:
        joint = native.joint(name)
        data.qpos[joint.qposadr[0]] = motion.position[name]
        data.qvel[joint.dofadr[0]] = motion.rate[name]
    controls = np.zeros((count, native.nu))
    for name, values in motion.controls.items():
        actuator = native.actuator(name)
        if name in motion.held:
            rows = np.searchsorted(time_s, grid[:count] + 1e-9 * step_s, side="right") - 1
            controls[:, actuator.id] = values[np.clip(rows, 0, len(values) - 1)]
        else:
            controls[:, actuator.id] = np.interp(grid[:count], time_s, values)
        if actuator.actnum[0]:
            data.act[actuator.actadr[0]] = values[0]
        if getattr(native, "nhistory", 0) and native.actuator_history[actuator.id, 0]:
            samples = int(native.actuator_history[actuator.id, 0])
            before_s = step_s * np.arange(-samples, 0.0)
            mujoco.mj_initCtrlHistory(native, data, actuator.id, before_s, np.full(samples, values[0]))
    positions = np.full((count + 1, len(joints)), np.nan)
    positions[0] = data.qpos[columns]
    for row in range(count):
        data.ctrl[:] = controls[row]
        mujoco.mj_step(native, data)
        if data.time <= 0.5 * step_s or not np.isfinite(data.qpos).all():
            break  # MuJoCo resets a simulation that diverges
        positions[row + 1] = data.qpos[columns]
    return np.column_stack([np.interp(time_s, grid, column) for column in positions.T])
