"""Forces that MJCF has no word for, as MuJoCo's passive callback: the compiled laws of effects at joints."""

import ctypes
from typing import Any

import numpy as np

from labrun.effects import AttachedEffect
from labrun.errors import ModelError
from labrun.models.mjcf.exporting import mjcf_of
from labrun.models.mjcf.model import MujocoModel
from labrun.models.mjcf.plant import imported
from labrun.models.model import Model

_DOUBLES = ctypes.POINTER(ctypes.c_double)
_LAW = ctypes.CFUNCTYPE(ctypes.c_double, *[ctypes.c_double] * 6, *[_DOUBLES] * 3)


class PassiveForces:
    """What to hand to ``mujoco.set_mjcb_passive``; adds forces to ``qfrc_passive``.

    A law that depends on what the drive puts on the joint sees the drive's force of the time step before: MuJoCo
    computes passive forces first. States of laws are integrated with the time steps of the simulation (Euler). A
    callback is global in MuJoCo: models in which none of the joints is found by name are left alone.
    """

    def __init__(self, laws: dict[str, list[AttachedEffect]]) -> None:
        self._laws = [_Law(joint, effect) for joint, effects in laws.items() for effect in effects]

    @property
    def effects(self) -> tuple[AttachedEffect, ...]:
        """The effects behind the forces."""
        return tuple(law.effect for law in self._laws)

    def __call__(self, model: Any, data: Any) -> None:
        """Add the forces at this state of a simulation."""
        mujoco = imported()
        for law in self._laws:
            joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, law.joint)
            if joint >= 0:
                dof = int(model.jnt_dofadr[joint])
                position, rate = data.qpos[model.jnt_qposadr[joint]], data.qvel[dof]
                stiffness = float(np.ravel(model.jnt_stiffness[joint])[0])
                data.qfrc_passive[dof] += law.force(
                    data.time, position, rate, data.qfrc_actuator[dof], stiffness
                )


class _Law:
    """The compiled law of an effect with its values and states."""

    def __init__(self, joint: str, effect: AttachedEffect) -> None:
        self.joint, self.effect, self._function = joint, effect, _LAW(effect.effect.function.address)
        self._values = np.array(effect.values, dtype=np.float64)
        self._z, self._dz = (np.zeros(max(1, effect.effect.states)) for _ in range(2))
        self._last_s = 0.0

    def force(self, time_s: float, position: float, rate: float, load: float, stiffness: float) -> float:
        if time_s == 0.0:
            self._z[:] = 0.0
        else:
            self._z += max(time_s - self._last_s, 0.0) * self._dz
        self._last_s = time_s
        arrays = (each.ctypes.data_as(_DOUBLES) for each in (self._values, self._z, self._dz))
        return float(self._function(time_s, position, rate, 0.0, load, stiffness, *arrays))


def passive_forces(model: Model) -> PassiveForces:
    """Return the forces of a corrected model that its exported MJCF has no word for.

    Those of effects that change with acceleration, and filters of commands, are no passive forces; `mjcf_of` lists
    them.

    Raises
    ------
    ModelError
        It is no model in MuJoCo, or none of its effects is left for a callback.
    """
    exported = mjcf_of(model)
    if not isinstance(model, MujocoModel) or not exported.passive:
        raise ModelError(
            f"{model.name} has no force that its MJCF cannot express", hint="load the MJCF alone"
        )
    laws: dict[str, list[AttachedEffect]] = {}
    for joint, effect in exported.passive:
        laws.setdefault(joint, []).append(effect)
    return PassiveForces(laws)
