"""Which equations hold by definition: that of an angle whose derivative is the rate lacks no force."""

import ctypes

import numpy as np

from labrun.gap.where.difference import Difference

_LOOKED_AT = 3


def defined(difference: Difference) -> frozenset[int]:
    """Return the states whose derivative is another state, whatever states, inputs and forces are.

    The equations are asked at a few points that no relation between states favours; equal is equal to the last bit.
    """
    model = difference.model
    size, inputs, sites = len(model.states), len(model.inputs), len(model.sites)
    pointers = [ctypes.c_void_p] * 5
    derivative = ctypes.CFUNCTYPE(None, ctypes.c_double, *pointers)(model.derivative.address)
    p = model.vector(difference.parameters, difference.units.trials[0].condition)
    equal = ~np.eye(size, dtype=bool)
    for point in range(1, _LOOKED_AT + 1):
        numbers = 0.3 * np.cos(point * np.sqrt(np.arange(2.0, 2.0 + size + inputs + sites)))
        x, u, force = np.split(numbers, [size, size + inputs])
        slope = np.full(size, np.nan)
        arrays = [np.ascontiguousarray(np.append(one, 0.0)) for one in (x, u, p, force)]
        derivative(0.1 * point, *[one.ctypes.data for one in arrays], slope.ctypes.data)
        equal &= slope[:, None] == x[None, :]
    return frozenset(np.flatnonzero(equal.any(axis=1)).tolist())
