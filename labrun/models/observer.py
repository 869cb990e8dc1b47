"""Stabilise a model by measured outputs: an observer around its equations."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import ThroughAddresses, generated
from labrun.models.model import Condition, Input, Model

_IMPORTS = """\
import numpy as np
from labrun.models.engine.calling import call_model
"""
_DERIVATIVE = """\
def derivative(t, x, u, p, force, out):
    shown = np.empty({outputs})
    call_model(int(p[{at} + 1]), t, x, u, p, force, shown)
    call_model(int(p[{at}]), t, x, u, p, force, out)
    for place in range({outputs}):
        shown[place] = u[{inputs} + place] - shown[place]
    for state in range({states}):
        for place in range({outputs}):
            out[state] += p[{at} + 2 + {outputs} * state + place] * shown[place]"""


@dataclass(frozen=True)
class ObservedModel(Model):
    """``dx/dt = derivative + gain (measured - output)``, with the measured outputs as further inputs.

    Attributes
    ----------
    gain : (states, outputs)
        Of the observer.
    """

    inner: Model = field(kw_only=True, repr=False)
    gain: FloatArray = field(kw_only=True, repr=False)

    def vector(self, parameters: FloatArray | Mapping[str, float] | None, condition: Condition) -> FloatArray:
        """Return `p` as the inner model does; behind it the addresses of its functions, and the gain."""
        given = super().vector(parameters, condition)[: len(self.parameters)]
        addresses = [float(function.address) for function in (self.inner.derivative, self.inner.output)]
        # an address has at most 48 bits, and a float64 holds 53 exactly
        return np.concatenate([self.inner.vector(given, condition), addresses, self.gain.ravel()])


def measured_name(output: str) -> str:
    """Return the name of the input that takes a measured output."""
    return f"{output}_measured"


def observed(model: Model, gain: FloatArray, condition: Condition) -> ObservedModel:
    """Return a model stabilised by measured outputs.

    After Luenberger, IEEE Trans. Automatic Control 11 (1966) 190. Its measured outputs are prescribed inputs, and its
    outputs are no places where something could be missing: what a sensor does to them moves the simulation as well.

    Parameters
    ----------
    gain : (states, outputs)
        By how much a state's derivative changes with what an output is short of.
    condition
        Of any trial.
    """
    at = len(model.vector(None, condition))
    numbers = {
        "at": at,
        "states": len(model.states),
        "inputs": len(model.inputs),
        "outputs": len(model.outputs),
    }
    made = generated({"derivative": _DERIVATIVE.format(**numbers)}, _IMPORTS)["derivative"]
    own = {attribute.name: getattr(model, attribute.name) for attribute in fields(Model) if attribute.init}
    measured = tuple(
        Input(measured_name(output.name), output.unit, prescribed=True) for output in model.outputs
    )
    own |= {
        "inputs": (*model.inputs, *measured),
        "outputs": tuple(replace(output, followed=True) for output in model.outputs),
        "derivative": ThroughAddresses("model", made.provide),
    }
    return ObservedModel(**own, inner=model, gain=np.asarray(gain, dtype=float))
