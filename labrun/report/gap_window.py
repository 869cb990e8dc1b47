"""The few cycles of a trace in which model and measurement differ most: a long swing hides them when shown whole."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_CYCLES = 3.0
_WHOLE = 0.6
"""A window that is longer than this part of the trace is the trace."""


def telling_window(time_s: FloatArray, simulated: FloatArray, difference: FloatArray) -> slice:
    """Return the samples of the window; all of them where the trace has few cycles.

    Parameters
    ----------
    time_s : (n,)
    simulated : (n,)
        A signal whose crossings of its mean tell how long a cycle is; of a model, since noise crosses at random.
    difference : (n,)
        What has its largest mean square in the window.
    """
    count = len(time_s)
    crossings = int(np.count_nonzero(np.diff(simulated > simulated.mean())))
    length = int(np.ceil(2.0 * _CYCLES * count / crossings)) if crossings else count
    if length > _WHOLE * count or length < 2:
        return slice(0, count)
    sums = np.concatenate([[0.0], np.cumsum(np.square(difference))])
    start = int(np.argmax(sums[length:] - sums[:-length]))
    return slice(start, start + length)
