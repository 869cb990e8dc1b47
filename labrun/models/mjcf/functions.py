"""The functions of a model in MuJoCo: short generated code around what is compiled once for all."""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from labrun.arrays import FloatArray
from labrun.compiled import NativeFunction, equations, generated
from labrun.toml import Expression

_IMPORTS = """\
from labrun.compiled import kernel
from labrun.models.mjcf.kernels import integers, numbers, reading, slope
from labrun.models.mjcf.table import SCRATCH
"""
_AROUND = """\
def {name}(t, x, u, p, force, out):
    table = integers(int(p[{at}]))
    settings(t, x, u, p, force, numbers(table[SCRATCH]))
    {called}(table, x, u, force, out)
    return"""


_DOUBLES = ctypes.POINTER(ctypes.c_double)
_SIGNATURE = ctypes.CFUNCTYPE(None, ctypes.c_double, *[_DOUBLES] * 5)


class ReachingMujoco(NativeFunction):
    """A native function that has no plain Python form, because it follows addresses."""

    @property
    def python(self) -> Callable[..., Any]:
        """The compiled function, callable with arrays as any other."""
        called = _SIGNATURE(self.address)

        def function(t: float, *arrays: FloatArray) -> None:
            called(t, *(one.ctypes.data_as(_DOUBLES) for one in arrays))

        return function


def functions(
    settings: Sequence[Expression], quantities: Sequence[Expression], places: Mapping[str, str], at: int
) -> dict[str, NativeFunction]:
    """Return derivative, output and site_values.

    Parameters
    ----------
    settings
        The values that are written to the MJCF model.
    quantities
        Coordinate, rate, load and stiffness of every site.
    places
        Where each name is found in the arguments.
    at
        Index in `p` of the address of the table.
    """
    made = generated(
        {
            "settings": "@kernel\n" + equations("settings", settings, dict(places)),
            "derivative": _AROUND.format(name="derivative", called="slope", at=at),
            "output": _AROUND.format(name="output", called="reading", at=at),
            "site_values": equations("site_values", quantities, dict(places)),
        },
        _IMPORTS,
    )
    reaching = {name: ReachingMujoco("model", made[name].provide) for name in ("derivative", "output")}
    return {**reaching, "site_values": made["site_values"]}
