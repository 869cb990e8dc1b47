"""A model whose equations are MuJoCo's: short generated code around what is compiled once for all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import NativeFunction, ThroughAddresses, equations, generated
from labrun.errors import ModelError
from labrun.models.mjcf.plant import MjcfLayout, plant
from labrun.models.model import Condition, Model
from labrun.toml import Expression

_IMPORTS = """\
from labrun.compiled import kernel
from labrun.models.mjcf.kernels import integers, numbers, reading, slope
from labrun.models.mjcf.plant import SCRATCH
"""
_AROUND = """\
def {name}(t, x, u, p, force, out):
    table = integers(int(p[{at}]))
    settings(t, x, u, p, force, numbers(table[SCRATCH]))
    {called}(table, x, u, force, out)
    return"""


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
    reaching = {name: ThroughAddresses("model", made[name].provide) for name in ("derivative", "output")}
    return {**reaching, "site_values": made["site_values"]}


@dataclass(frozen=True)
class MujocoModel(Model):
    """A model like any other: its functions ask MuJoCo for accelerations, labrun integrates.

    Attributes
    ----------
    layout
        The compiled MJCF model, and where in it states, inputs, outputs, sites and parameters are.
    mjcf
        The path of its MJCF file, or the file's text.
    """

    layout: MjcfLayout = field(kw_only=True, repr=False)
    mjcf: str = field(kw_only=True, repr=False, default="")

    def vector(self, parameters: FloatArray | Mapping[str, float] | None, condition: Condition) -> FloatArray:
        """Return `p` as `Model.vector` does; its last number leads compiled code to this thread's MuJoCo.

        The vector is good for simulations in the process and thread that asked for it.

        Raises
        ------
        ModelError
            As `Model.vector`, and where the model's parameters were replaced by others.
        """
        p = super().vector(parameters, condition)
        if len(p) != self.layout.at:  # an address read from the wrong place would end the process
            raise ModelError(
                f"model {self.name} takes {self.layout.at} parameters and conditions, and now has {len(p)}",
                hint="in MuJoCo, a model's parameters can get other values but not be others",
            )
        # an address has at most 48 bits, and a float64 holds 53 exactly
        return np.append(p, float(plant(self.layout).address))
