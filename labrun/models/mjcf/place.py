"""Places in MuJoCo's memory, told by name so that they mean the same in another process."""

import ctypes
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from labrun.errors import ModelError

if TYPE_CHECKING:
    import mujoco

BYTES = 8
"""MuJoCo's numbers are float64."""
_BEHIND_GRAVITY = {"density": 9, "viscosity": 10}
"""Numbers of ``mjOption`` that Python sees as scalars, by their distance from its gravity."""


@dataclass(frozen=True, slots=True)
class Place:
    """One number.

    Attributes
    ----------
    owner
        The compiled model, its options, or the data of a simulation.
    array, index
        Its field, and where in the flattened field it is.
    factor
        What is written there is this times the value.
    """

    owner: Literal["model", "option", "data"]
    array: str
    index: int
    factor: float = 1.0

    def address(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> int:
        """Return where it is in this process."""
        if self.owner == "option" and self.array in _BEHIND_GRAVITY:
            return _checked(model, self.array)
        return int(self._field(model, data).ctypes.data) + BYTES * self.index

    def _field(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> NDArray[np.float64]:
        owners: dict[str, Any] = {"model": model, "option": model.opt, "data": data}
        field: NDArray[np.float64] = getattr(owners[self.owner], self.array)
        return field


def _checked(model: "mujoco.MjModel", option: str) -> int:
    """Return the address of a scalar option, once it is seen to be there in this version of MuJoCo."""
    address = int(model.opt.gravity.ctypes.data) + BYTES * _BEHIND_GRAVITY[option]
    there = ctypes.c_double.from_address(address)
    before = getattr(model.opt, option)
    for probe in (before + 1.0, before):
        setattr(model.opt, option, probe)
        if there.value != probe:
            setattr(model.opt, option, before)
            raise ModelError(f"this version of MuJoCo keeps option.{option} where labrun does not find it")
    return address
