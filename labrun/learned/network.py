"""A feed-forward network as plain arrays: layers, an activation, and the scaling of what goes in and out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.special import expit

from labrun.arrays import FloatArray

Activation = Literal["identity", "logistic", "tanh", "relu"]
ACTIVATIONS: tuple[Activation, ...] = get_args(Activation)
_FUNCTIONS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "identity": lambda x: x,
    "logistic": lambda x: np.asarray(expit(x)),
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}
_LEAST_SCALE = 1e-12


@dataclass(frozen=True, slots=True)
class Scaling:
    """``(value - mean) / scale`` for each input or output; both of shape (n,)."""

    mean: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, values: FloatArray) -> "Scaling":
        """Return the scaling to zero mean and unit variance of (samples, n); what never changes is only shifted."""
        spread = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(spread > _LEAST_SCALE, spread, 1.0))

    def scaled(self, values: FloatArray) -> FloatArray:
        """Return values in units of their spread."""
        return (values - self.mean) / self.scale

    def back(self, scaled: FloatArray) -> FloatArray:
        """Return what `scaled` was given."""
        return scaled * self.scale + self.mean

    @property
    def sound(self) -> bool:
        """Tell whether all its numbers are finite, and every scale above 0."""
        return bool(np.isfinite(self.mean).all() and np.isfinite(self.scale).all() and (self.scale > 0).all())


@dataclass(frozen=True, slots=True)
class Network:
    """A multilayer perceptron (source, section 4.2: 4.1 to 4.4 are its activations); its output layer is linear.

    Attributes
    ----------
    weights, biases
        Of each layer: (from, to) and (to,).
    activation
        Of every layer but the last.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    activation: Activation
    inputs: Scaling
    outputs: Scaling

    @property
    def hidden(self) -> tuple[int, ...]:
        """Neurons of each hidden layer."""
        return tuple(len(bias) for bias in self.biases[:-1])

    @property
    def finite(self) -> bool:
        """Tell whether all its numbers are."""
        return all(bool(np.isfinite(weight).all()) for weight in (*self.weights, *self.biases))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return the outputs, shape (n, outputs), for inputs of shape (n, inputs)."""
        function = _FUNCTIONS[self.activation]
        here = self.inputs.scaled(values)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            here = function(here @ weight + bias)
        return self.outputs.back(here @ self.weights[-1] + self.biases[-1])

    def point(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return the outputs for one set of inputs."""
        return tuple(self(np.array([values]))[0].tolist())

    @np.errstate(over="ignore", invalid="ignore")  # a loop tells which of its drives is not a number
    def collapsed(self) -> "Network":
        """Return the one affine layer that a network with identity activation is, however deep.

        Raises
        ------
        ValueError
            Another activation: such a network is no affine map.
        """
        if self.activation != "identity":
            raise ValueError(f"a network with {self.activation} activation is not an affine map")
        weight, bias = self.weights[0], self.biases[0]
        for after, shift in zip(self.weights[1:], self.biases[1:], strict=True):
            weight, bias = weight @ after, bias @ after + shift
        return Network((weight,), (bias,), "identity", self.inputs, self.outputs)
