"""Networks from samples: trained by scikit-learn, or affine ones by least squares, on all data or a sliding window."""

import math
import time
import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.learned.network import Activation, Network, Scaling

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
    coefficients = np.asarray(
        np.linalg.lstsq(columns, after.scaled(outputs), rcond=None)[0], dtype=np.float64
    )
    return Network((coefficients[:-1],), (coefficients[-1],), "identity", before, after)


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
        capacity = window or 0  # what counts for ever is never taken out again
        self._z, self._e = np.empty((capacity, size)), np.empty((capacity, out))
        self.count = 0
        """Samples taken so far."""

    def add(self, inputs: FloatArray, outputs: FloatArray) -> None:
        """Take samples, (n, inputs) and (n, outputs), oldest first; the oldest leave a full window.

        A sample that is no finite number teaches nothing.
        """
        finite = np.isfinite(inputs).all(axis=1) & np.isfinite(outputs).all(axis=1)
        inputs, outputs = inputs[finite], outputs[finite]
        z = np.column_stack([self._start.inputs.scaled(inputs), np.ones(len(inputs))])
        e = self._start.outputs.scaled(outputs) - z @ self._w0
        self._gram += z.T @ z
        self._moment += z.T @ e
        window = self._window
        if window is not None:
            for row in range(len(z)):
                slot = (self.count + row) % window
                if self.count + row >= window:
                    old_z, old_e = self._z[slot], self._e[slot]
                    self._gram -= np.outer(old_z, old_z)
                    self._moment -= np.outer(old_z, old_e)
                self._z[slot], self._e[slot] = z[row], e[row]
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
        weights = np.full_like(self._w0, np.nan)  # sums that overflowed give none
        if np.isfinite(full).all() and np.isfinite(self._moment).all():
            # least squares: without a ridge the first samples leave directions open, and those stay where they were
            weights = self._w0 + np.linalg.lstsq(full, self._moment, rcond=None)[0]
        start = self._start
        return Network((weights[:-1],), (weights[-1],), "identity", start.inputs, start.outputs)


Solver = Literal["lbfgs", "adam"]


@dataclass(frozen=True, slots=True)
class Training:
    """How a network is trained.

    Attributes
    ----------
    hidden
        Neurons of each hidden layer.
    alpha
        Penalty on the squared weights (scaled), over the number of samples.
    most_iterations, tolerance
        Of the solver.
    """

    hidden: tuple[int, ...] = (4, 4)
    activation: Activation = "identity"
    solver: Solver = "lbfgs"
    alpha: float = 1e-4
    most_iterations: int = 2000
    tolerance: float = 1e-8


def train(
    training: Training, inputs: FloatArray, outputs: FloatArray, *, seed: int, start: Network | None = None
) -> tuple[Network, float]:
    """Train a network on samples of shape (n, inputs) and (n, outputs).

    Parameters
    ----------
    seed
        Of the first weights.
    start
        A network of the same layers, whose weights and scaling are taken up.

    Returns
    -------
    Network, float
        And how long the training took, s.

    Raises
    ------
    RequestError
        scikit-learn is not installed.
    """
    regressor = _regressor_class()
    before = Scaling.of(inputs) if start is None else start.inputs
    after = Scaling.of(outputs) if start is None else start.outputs
    x, y = before.scaled(inputs), after.scaled(outputs)
    made = regressor(
        hidden_layer_sizes=training.hidden,
        activation=training.activation,
        solver=training.solver,
        alpha=training.alpha,
        max_iter=training.most_iterations,
        max_fun=20 * training.most_iterations,
        tol=training.tolerance,
        random_state=seed,
        warm_start=start is not None,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it stopped at most_iterations: the error on withheld data tells
        if start is not None:
            made.set_params(max_iter=1)
            made.fit(x[:2], y[:2])
            made.coefs_ = [weight.copy() for weight in start.weights]
            made.intercepts_ = [bias.copy() for bias in start.biases]
            made.set_params(max_iter=training.most_iterations)
            if training.solver == "adam":
                del made._optimizer  # its steps were of other weights
        began_s = time.perf_counter()
        made.fit(x, y)
        took_s = time.perf_counter() - began_s
    weights = tuple(np.asarray(layer, dtype=np.float64) for layer in made.coefs_)
    biases = tuple(np.asarray(layer, dtype=np.float64) for layer in made.intercepts_)
    return Network(weights, biases, training.activation, before, after), took_s


def _regressor_class() -> Any:
    try:
        from sklearn.neural_network import MLPRegressor
    except ImportError as error:
        raise RequestError(
            "networks are trained by scikit-learn, which is not installed",
            hint="pip install 'labrun[learn]'; networks that are trained already need it no more",
        ) from error
    return MLPRegressor
