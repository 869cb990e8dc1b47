"""One MuJoCo simulation in memory, and the table through which compiled code reaches it."""

import ctypes
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labrun.errors import ModelError

_SETTLED = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "xfrc_applied")
"""What stands in MuJoCo's memory before its equations are evaluated."""


(
    FORWARD, APPLY, MODEL, DATA, WARNINGS, WARNINGS_COUNT,
    FORCES, FORCES_COUNT,
    STATES, STATES_COUNT, RATES,
    QUATERNIONS, QUATERNIONS_COUNT, QUATERNION_VELOCITIES,
    INPUTS, INPUTS_COUNT, INPUTS_ADD,
    SITES, SITES_COUNT,
    VALUES_COUNT, SCRATCH, LAST,
    OUTPUTS, OUTPUTS_COUNT, OUTPUTS_NEED_FORWARD,
    SIZE,
) = range(26)  # fmt: skip
"""What stands where in the table of integers through which compiled code reaches MuJoCo.

Functions and what is plural stand for addresses, names with ``COUNT`` for how many there are.
"""
_WARNINGS = ("mjWARN_INERTIA", "mjWARN_CONTACTFULL", "mjWARN_CNSTRFULL")
"""After one of these, what MuJoCo computed is not what its equations say."""


@dataclass(frozen=True, slots=True)
class MemoryPlace:
    """One number in MuJoCo's memory, addressed by name so that it is valid in other processes.

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

    def address(self, model: Any, data: Any) -> int:
        """Return where it is in this process: in the memory of the array that MuJoCo shows."""
        field: NDArray[np.float64] = getattr(self._owner(model, data), self.array)
        return int(field.ctypes.data) + field.itemsize * self.index

    def read(self, model: Any) -> float:
        """Return the number."""
        return float(np.ravel(getattr(self._owner(model), self.array))[self.index]) / self.factor

    def write(self, model: Any, value: float) -> None:
        """Set the number, as a user of MuJoCo would."""
        owner = self._owner(model)
        field = getattr(owner, self.array)
        if isinstance(field, np.ndarray):
            field.reshape(-1)[self.index] = self.factor * value
        else:
            setattr(owner, self.array, self.factor * value)

    def _owner(self, model: Any, data: Any = None) -> Any:
        return {"model": model, "option": model.opt, "data": data}[self.owner]


@dataclass(frozen=True)
class MjcfLayout:
    """A compiled MJCF model and where in it everything is; means the same in every process.

    Attributes
    ----------
    binary
        The compiled model as MuJoCo stores it, meshes and all.
    key
        Digest of all of it.
    at
        Where in `p` the address of the table stands: behind the parameters and conditions.
    rates
        Where its derivative is found after MuJoCo's forward dynamics; None for parts of quaternions.
    quaternions : (first state, its angular velocity)
    sites
        Where the force at each site is applied.
    values
        How many attributes the parameters set.
    settings : (which value, where it goes)
    """

    binary: bytes
    key: str
    at: int
    states: tuple[MemoryPlace, ...]
    rates: tuple[MemoryPlace | None, ...]
    quaternions: tuple[tuple[int, MemoryPlace], ...]
    inputs: tuple[MemoryPlace, ...]
    sites: tuple[MemoryPlace, ...]
    values: int
    settings: tuple[tuple[int, MemoryPlace], ...]
    outputs: tuple[MemoryPlace, ...]


def imported() -> Any:
    """Return the module `mujoco`, which takes a while to load. Raises ModelError: it cannot be loaded."""
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(
            f"MuJoCo, which comes with labrun, cannot be loaded: {error}",
            hint="pip install --force-reinstall mujoco",
        ) from None
    return mujoco


def has_loops(model: Any) -> bool:
    """Tell whether a compiled model has equality constraints that close loops."""
    return bool(np.isin(model.eq_type, loop_kinds()).any())


def loop_kinds() -> list[int]:
    """Return the kinds of equality constraints that close loops: ``connect`` and ``weld``."""
    kinds = imported().mjtEq
    return [int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)]


def pack(model: Any) -> bytes:
    """Return a compiled model as bytes."""
    mujoco = imported()
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def plant(layout: MjcfLayout) -> "MujocoPlant":
    """Return the simulation of a layout that belongs to this thread."""
    # numba's code runs without the GIL: two threads in one simulation would write over one another
    key = (layout.key, threading.get_ident())
    if key not in _PLANTS:
        _PLANTS[key] = MujocoPlant(layout)
    return _PLANTS[key]


class MujocoPlant:
    """The memory of one simulation; nothing of it outlasts a call but which parameters were set last."""

    def __init__(self, layout: MjcfLayout) -> None:
        mujoco = imported()
        self.model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": layout.binary})
        self.data = mujoco.MjData(self.model)
        # a derivative must depend on its arguments alone, not on where the constraint solver ended last time
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
        self.model.opt.enableflags &= ~int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))
        if not (self.model.geom_contype.any() or self.model.geom_conaffinity.any() or self.model.npair):
            # nothing can touch anything: not to look for it saves a sixth of the time
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._settings = layout.settings
        self._loosen([memory for _, memory in layout.settings])
        self._kept: list[NDArray[Any]] = []
        self._last = np.full(max(1, layout.values), np.nan)
        self._apply = ctypes.CFUNCTYPE(ctypes.c_int64)(self._set)
        _hush()
        self._table = self._filled(layout)

    @property
    def address(self) -> int:
        """Address of the table."""
        return int(self._table.ctypes.data)

    def _set(self) -> int:
        """Write the attributes that parameters set; compiled code calls this where they changed. Returns 0 if refused.

        MuJoCo derives constants from them, which costs more than writing them from Python does.
        """
        mujoco = imported()
        try:
            for source, memory in self._settings:
                memory.write(self.model, float(self._last[source]))
            mujoco.mj_setConst(self.model, self.data)
        except (ValueError, mujoco.FatalError):
            return 0
        return 1

    def _loosen(self, changed: list[MemoryPlace]) -> None:
        """Undo the shortcuts MuJoCo takes for frames that coincide, where they may cease to."""
        model = self.model
        for body in _moved_bodies(model, changed):
            model.body_sameframe[body] = 0
            model.geom_sameframe[model.geom_bodyid == body] = 0
            model.site_sameframe[model.site_bodyid == body] = 0

    def _filled(self, layout: MjcfLayout) -> NDArray[np.int64]:
        model, data = self.model, self.data
        table = np.zeros(SIZE, dtype=np.int64)

        def addresses(places: Sequence[MemoryPlace | None]) -> int:
            return array([0 if location is None else location.address(model, data) for location in places])

        def array(values: Any, kind: type = np.int64) -> int:
            self._kept.append(np.array(values, dtype=kind) if len(values) else np.zeros(1, dtype=kind))
            return int(self._kept[-1].ctypes.data)

        warnings = data.warning.number
        table[FORWARD] = _function("mj_forwardSkip")
        table[APPLY] = int(ctypes.cast(self._apply, ctypes.c_void_p).value or 0)
        table[MODEL], table[DATA] = model._address, data._address
        kinds = [int(getattr(imported().mjtWarning, name)) for name in _WARNINGS]
        table[WARNINGS] = array([warnings[kind:].ctypes.data for kind in kinds])
        table[WARNINGS_COUNT] = len(kinds)
        table[FORCES], table[FORCES_COUNT] = data.qfrc_applied.ctypes.data, model.nv
        table[STATES], table[STATES_COUNT] = addresses(layout.states), len(layout.states)
        table[RATES] = addresses(layout.rates)
        table[QUATERNIONS] = array([first for first, _ in layout.quaternions])
        table[QUATERNIONS_COUNT] = len(layout.quaternions)
        table[QUATERNION_VELOCITIES] = addresses([spin for _, spin in layout.quaternions])
        table[INPUTS], table[INPUTS_COUNT] = addresses(layout.inputs), len(layout.inputs)
        table[INPUTS_ADD] = array([int(signal.array == "qfrc_applied") for signal in layout.inputs])
        table[SITES], table[SITES_COUNT] = addresses(layout.sites), len(layout.sites)
        table[VALUES_COUNT] = layout.values
        table[SCRATCH] = array([0.0] * layout.values, float)
        table[LAST] = self._last.ctypes.data
        table[OUTPUTS], table[OUTPUTS_COUNT] = addresses(layout.outputs), len(layout.outputs)
        table[OUTPUTS_NEED_FORWARD] = any(output.array not in _SETTLED for output in layout.outputs)
        return table


def _function(name: str) -> int:
    """Return the address of a function of MuJoCo's C interface, in the library that the package has loaded."""
    library = ctypes.CDLL(imported()._functions.__file__)
    return int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)


def _moved_bodies(model: Any, places: Sequence[MemoryPlace]) -> set[int]:
    """Return the bodies whose own frame or mass some of the places change."""
    widths = {"body_mass": 1, "body_inertia": 3, "body_ipos": 3, "body_pos": 3}
    bodies = {location.index // widths[location.array] for location in places if location.array in widths}
    geoms = {location.index // 3 for location in places if location.array == "geom_pos"}
    sites = {location.index // 3 for location in places if location.array == "site_pos"}
    bodies |= {int(model.geom_bodyid[geom]) for geom in geoms}
    return bodies | {int(model.site_bodyid[site]) for site in sites}


def _hush() -> None:
    """Keep MuJoCo from writing ``MUJOCO_LOG.TXT`` where one works, unless someone listens to its warnings already.

    The simulation that a warning spoils says so itself.
    """
    mujoco = imported()
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_LISTENER)


_LISTENER = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(lambda _message: None)
_PLANTS: dict[tuple[str, int], MujocoPlant] = {}
"""Kept for the life of the process: compiled code holds addresses into them."""
