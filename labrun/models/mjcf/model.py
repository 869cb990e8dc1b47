"""A model whose equations are MuJoCo's."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import ModelError
from labrun.models.mjcf.plant import Layout, plant
from labrun.models.model import Condition, Model


@dataclass(frozen=True)
class MujocoModel(Model):
    """A model like any other: its functions ask MuJoCo for accelerations, labrun integrates.

    Attributes
    ----------
    layout
        The compiled MJCF model, and where in it states, inputs, outputs, sites and parameters are.
    """

    layout: Layout = field(kw_only=True, repr=False)

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
