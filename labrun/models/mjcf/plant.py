"""One MuJoCo simulation in memory, and the table through which compiled code reaches it."""

import ctypes
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labrun.errors import ModelError
from labrun.models.mjcf import table as at
from labrun.models.mjcf.place import Place

if TYPE_CHECKING:
    import mujoco

_INSTALL = 'pip install "labrun[mujoco]"'
_SETTLED = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "xfrc_applied")
"""What stands in MuJoCo's memory before its equations are evaluated."""


@dataclass(frozen=True)
class Layout:
    """A compiled MJCF model and where in it everything is; means the same in every process.

    Attributes
    ----------
    binary
        The compiled model as MuJoCo stores it, meshes and all.
    key
        Digest of all of it.
    at
        Where in `p` the address of the table stands: behind the parameters and conditions.
    states
        Where each state is.
    rates
        Where its derivative is found after MuJoCo's forward dynamics; None for parts of quaternions.
    quaternions : (first state, its angular velocity)
    inputs
        Where each input goes.
    sites
        Where the force at each site is applied.
    values
        How many attributes the parameters set.
    settings : (which value, where it goes)
    outputs
        Where each output is.
    """

    binary: bytes
    key: str
    at: int
    states: tuple[Place, ...]
    rates: tuple[Place | None, ...]
    quaternions: tuple[tuple[int, Place], ...]
    inputs: tuple[Place, ...]
    sites: tuple[Place, ...]
    values: int
    settings: tuple[tuple[int, Place], ...]
    outputs: tuple[Place, ...]


def imported() -> Any:
    """Return the module `mujoco`.

    Raises
    ------
    ModelError
        It is not installed, with the line that installs it.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(f"a model in MuJoCo needs the package mujoco: {error}", hint=_INSTALL) from None
    return mujoco


def pack(model: "mujoco.MjModel") -> bytes:
    """Return a compiled model as bytes."""
    mujoco = imported()
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def plant(layout: Layout) -> "Plant":
    """Return the simulation of a layout that belongs to this thread."""
    # numba's code runs without the GIL: two threads in one simulation would write over one another
    key = (layout.key, threading.get_ident())
    if key not in _PLANTS:
        _PLANTS[key] = Plant(layout)
    return _PLANTS[key]


class Plant:
    """The memory of one simulation; nothing of it outlasts a call but which parameters were set last."""

    def __init__(self, layout: Layout) -> None:
        mujoco = imported()
        self.model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": layout.binary})
        self.data = mujoco.MjData(self.model)
        # a derivative must depend on its arguments alone, not on where the constraint solver ended last time
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
        self.model.opt.enableflags &= ~int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))
        if not (self.model.geom_contype.any() or self.model.geom_conaffinity.any() or self.model.npair):
            # nothing can touch anything: not to look for it saves a sixth of the time
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._loosen([place for _, place in layout.settings])
        self._kept: list[NDArray[Any]] = []
        library = ctypes.CDLL(mujoco._functions.__file__)
        _hush(library)
        self._table = self._filled(layout, library)

    @property
    def address(self) -> int:
        """Address of the table."""
        return int(self._table.ctypes.data)

    def _loosen(self, changed: list[Place]) -> None:
        """Undo the shortcuts MuJoCo takes for frames that coincide, where they may cease to."""
        model = self.model
        for body in _moved_bodies(model, changed):
            model.body_sameframe[body] = 0
            model.geom_sameframe[model.geom_bodyid == body] = 0
            model.site_sameframe[model.site_bodyid == body] = 0

    def _filled(self, layout: Layout, library: ctypes.CDLL) -> NDArray[np.int64]:
        model, data = self.model, self.data
        table = np.zeros(at.SIZE, dtype=np.int64)

        def address(place: Place | None) -> int:
            return 0 if place is None else place.address(model, data)

        def array(values: Any, kind: type = np.int64) -> int:
            self._kept.append(np.array(values, dtype=kind) if len(values) else np.zeros(1, dtype=kind))
            return int(self._kept[-1].ctypes.data)

        def function(name: str) -> int:
            return int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)

        table[at.FORWARD], table[at.SET_CONSTANTS] = function("mj_forwardSkip"), function("mj_setConst")
        table[at.MODEL], table[at.DATA] = model._address, data._address
        numbers = data.warning.number  # of structures of two int32, the number second: eight bytes each
        table[at.WARNINGS] = numbers.ctypes.data - numbers.itemsize
        table[at.FORCES], table[at.FORCES_COUNT] = data.qfrc_applied.ctypes.data, model.nv
        table[at.STATES] = array([address(one) for one in layout.states])
        table[at.STATES_COUNT] = len(layout.states)
        table[at.RATES] = array([address(one) for one in layout.rates])
        table[at.QUATERNIONS] = array([first for first, _ in layout.quaternions])
        table[at.QUATERNIONS_COUNT] = len(layout.quaternions)
        table[at.QUATERNION_VELOCITIES] = array([address(spin) for _, spin in layout.quaternions])
        table[at.INPUTS] = array([address(one) for one in layout.inputs])
        table[at.INPUTS_COUNT] = len(layout.inputs)
        table[at.INPUTS_ADD] = array([int(one.array == "qfrc_applied") for one in layout.inputs])
        table[at.SITES] = array([address(one) for one in layout.sites])
        table[at.SITES_COUNT] = len(layout.sites)
        table[at.VALUES_COUNT] = layout.values
        table[at.SCRATCH] = array([0.0] * layout.values, float)
        table[at.LAST] = array([np.nan] * layout.values, float)
        table[at.SETTINGS] = array([address(place) for _, place in layout.settings])
        table[at.SETTINGS_COUNT] = len(layout.settings)
        table[at.SETTINGS_FROM] = array([source for source, _ in layout.settings])
        table[at.SETTINGS_FACTORS] = array([place.factor for _, place in layout.settings], float)
        table[at.OUTPUTS] = array([address(one) for one in layout.outputs])
        table[at.OUTPUTS_COUNT] = len(layout.outputs)
        table[at.OUTPUTS_NEED_FORWARD] = any(one.array not in _SETTLED for one in layout.outputs)
        return table


def _moved_bodies(model: "mujoco.MjModel", places: Sequence[Place]) -> set[int]:
    """Return the bodies whose own frame or mass some of the places change."""
    widths = {"body_mass": 1, "body_inertia": 3, "body_ipos": 3, "body_pos": 3}
    bodies = {one.index // widths[one.array] for one in places if one.array in widths}
    geoms = {one.index // 3 for one in places if one.array == "geom_pos"}
    sites = {one.index // 3 for one in places if one.array == "site_pos"}
    bodies |= {int(model.geom_bodyid[one]) for one in geoms}
    return bodies | {int(model.site_bodyid[one]) for one in sites}


def _say_nothing(_message: bytes) -> None:
    """Take a warning of MuJoCo's: the simulation that it spoils says so itself."""


_LISTENER = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(_say_nothing)


def _hush(library: ctypes.CDLL) -> None:
    """Keep MuJoCo from writing ``MUJOCO_LOG.TXT`` where one works, unless someone listens to its warnings already."""
    listener = ctypes.c_void_p.in_dll(library, "mju_user_warning")
    if not listener.value:
        listener.value = ctypes.cast(_LISTENER, ctypes.c_void_p).value


_PLANTS: dict[tuple[str, int], Plant] = {}
"""Kept for the life of the process: compiled code holds addresses into them."""
