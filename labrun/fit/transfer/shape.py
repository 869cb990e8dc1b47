"""Which transfer function is looked for, and the numbers that the search moves.

The denominator is a product of sections ``a2 s^2 + a1 s + 1`` (and one ``a1 s + 1`` if the order is odd) whose
coefficients are powers of e: every point of the search is stable, and every stable denominator is one of its points.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Initial = Literal["steady", "free"]


@dataclass(frozen=True, slots=True)
class Shape:
    """What is looked for.

    Attributes
    ----------
    poles, zeros
        How many.
    dead_time
        Whether there is one.
    initial
        What each trial starts from: the steady state of its first input, or anything.
    """

    poles: int
    zeros: int
    dead_time: bool = True
    initial: Initial = "steady"

    @property
    def moved(self) -> int:
        """How many numbers the search moves: the denominator's, and the dead time."""
        return self.poles + int(self.dead_time)

    @property
    def linear(self) -> int:
        """How many follow from those by linear least squares: the numerator's."""
        return self.zeros + 1

    @property
    def size(self) -> int:
        """How many numbers describe it."""
        return self.moved + self.linear

    def denominator(self, moved: FloatArray) -> tuple[float, ...]:
        """Return the denominator, its last coefficient 1."""
        product = np.ones(1)
        for place in range(0, self.poles - 1, 2):
            product = np.polymul(product, [np.exp(moved[place]), np.exp(moved[place + 1]), 1.0])
        if self.poles % 2:
            product = np.polymul(product, [np.exp(moved[self.poles - 1]), 1.0])
        return tuple(float(one) for one in product)

    def dead_s(self, moved: FloatArray) -> float:
        """Return the dead time, s."""
        return max(float(moved[self.poles]), 0.0) if self.dead_time else 0.0

    def at(self, poles: NDArray[np.complex128], dead_s: float) -> FloatArray:
        """Return the point of a set of poles, unstable ones mirrored to the left, and of a dead time."""
        left = -np.abs(poles.real) + 1j * poles.imag
        left = np.where(left.real == 0.0, left - 1e-3 * np.abs(left) - 1e-9, left)
        pairs = sorted(left[left.imag > 1e-12], key=abs)
        single = sorted(left[np.abs(left.imag) <= 1e-12].real, key=abs)
        sections = [(abs(one) ** 2, -2.0 * one.real) for one in pairs]
        while len(single) > 1:
            one, other = single.pop(0), single.pop(0)
            sections.append((one * other, -one - other))
        point = [np.log(value) for c, b in sections for value in (1.0 / c, b / c)]
        if single:
            point.append(np.log(-1.0 / single[0]))
        return np.array([*point, dead_s] if self.dead_time else point)
