"""Affine maps by least squares: exact on all data, and on a window that slides along."""

import math

import numpy as np

from labrun.arrays import FloatArray
from labrun.learned.network import Network, Scaling

_REFRESH = 2048
"""Samples after which the sums of a window are formed anew: what is added and taken away again leaves rounding."""


def exact_affine(inputs: FloatArray, outputs: FloatArray) -> Network:
    """Return the affine map of least squares, the best that a network with identity activation can be.

    Parameters
    ----------
    inputs, outputs : (n, inputs), (n, outputs)

    Returns
    -------
    Network
        Of one layer. Directions in which the inputs do not vary get no weight (minimum norm).
    """
    before, after = Scaling.of(inputs), Scaling.of(outputs)
    columns = np.column_stack([before.scaled(inputs), np.ones(len(inputs))])
    found = np.asarray(np.linalg.lstsq(columns, after.scaled(outputs), rcond=None)[0], dtype=np.float64)
    return Network((found[:-1],), (found[-1],), "identity", before, after)


class SlidingAffine:
    """Affine least squares over the latest samples, updated sample by sample.

    With z the scaled inputs and a one, W0 the weights at the beginning and n samples in the window it solves
    ``(sum z z' + ridge n I) (W - W0) = sum z (y - W0' z)'``: a stretch of a path that moves one way only leaves some
    coefficients open, and those stay where they were.

    Parameters
    ----------
    start
        An affine network (see `Network.collapsed`): W0 and the scaling, which stays.
    window
        Samples that count; None for all that there ever were.
    ridge
        How hard the weights are held at W0, relative to the inputs' variance.
    """

    def __init__(self, start: Network, window: int | None, ridge: float) -> None:
        (weight,), (bias,) = start.weights, start.biases
        self._start = start
        self._w0 = np.vstack([weight, bias])
        self._ridge = ridge
        self._window = window
        size, out = self._w0.shape
        self._gram, self._moment = np.zeros((size, size)), np.zeros((size, out))
        capacity = 1024 if window is None else window
        self._z, self._e = np.empty((capacity, size)), np.empty((capacity, out))
        self.count = 0
        """Samples taken so far."""

    def add(self, inputs: FloatArray, outputs: FloatArray) -> None:
        """Take samples, (n, inputs) and (n, outputs), oldest first; the oldest leave a full window."""
        z = np.column_stack([self._start.inputs.scaled(inputs), np.ones(len(inputs))])
        e = self._start.outputs.scaled(outputs) - z @ self._w0
        self._gram += z.T @ z
        self._moment += z.T @ e
        window = self._window
        if window is not None:
            for row in range(len(z)):
                place = (self.count + row) % window
                if self.count + row >= window:
                    old_z, old_e = self._z[place], self._e[place]
                    self._gram -= np.outer(old_z, old_z)
                    self._moment -= np.outer(old_z, old_e)
                self._z[place], self._e[place] = z[row], e[row]
            if (self.count + len(z)) // _REFRESH > self.count // _REFRESH:
                kept = min(self.count + len(z), window)
                self._gram = self._z[:kept].T @ self._z[:kept]
                self._moment = self._z[:kept].T @ self._e[:kept]
        self.count += len(z)

    def solved(self) -> Network:
        """Return the network of the window; the one at the beginning before there is a sample."""
        if self.count == 0:
            return self._start
        held = min(self.count, self._window or math.inf)
        full = self._gram + self._ridge * held * np.eye(len(self._gram))
        weights = self._w0 + np.linalg.solve(full, self._moment)
        start = self._start
        return Network((weights[:-1],), (weights[-1],), "identity", start.inputs, start.outputs)
