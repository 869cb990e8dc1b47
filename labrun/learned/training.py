"""Training of networks by scikit-learn, from random weights or from those of another network."""

import time
import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.learned.network import Activation, Network, Scaling

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
    weights = tuple(np.asarray(one, dtype=np.float64) for one in made.coefs_)
    biases = tuple(np.asarray(one, dtype=np.float64) for one in made.intercepts_)
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
