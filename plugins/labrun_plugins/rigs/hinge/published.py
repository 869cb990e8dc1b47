"""The polynomials of the source work: which terms they have, and the published coefficients, corrected."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labrun.devices import FloatArray

Term = tuple[str, int]
"""A variable and its power; ("", 0) is the constant."""

CONSTANT: Term = ("", 0)
VARIABLES = ("a", "l", "w")
"""Area (m^2), length and width (m), in the order of (3.11)."""
Quantity = Literal["stiffness", "damping"]
SYMBOLS: Mapping[Quantity, str] = {"damping": "b", "stiffness": "k"}
UNITS: Mapping[Quantity, str] = {"damping": "N m s/rad", "stiffness": "N m/rad"}
_POWER_UNITS = {
    ("a", 1): "m^2",
    ("a", 2): "m^4",
    ("l", 1): "m",
    ("l", 2): "m^2",
    ("w", 1): "m",
    ("w", 2): "m^2",
}


@dataclass(frozen=True, slots=True)
class Published:
    """A map of the source work, in metres and square metres; misprints corrected as `dimensions` tells.

    Attributes
    ----------
    equation
        Its number.
    mae, mae_percent
        Published mean absolute error, where there is one.
    """

    equation: str
    coefficients: Mapping[Term, float]
    mae: float | None = None
    mae_percent: float | None = None

    def value(self, sizes: Mapping[str, float]) -> float:
        """Return the map's value; not clamped, so that a negative one shows."""
        return float(
            sum(c * (sizes[name] ** power if name else 1.0) for (name, power), c in self.coefficients.items())
        )


def _quadratic(name: str, square: float, linear: float, constant: float) -> dict[Term, float]:
    return {(name, 2): square, (name, 1): linear, CONSTANT: constant}


PUBLISHED: Mapping[tuple[Quantity, tuple[str, ...]], Published] = {
    ("damping", ("a",)): Published("(3.6)", _quadratic("a", 2.34, -0.0042, 1.8e-5)),
    ("damping", ("w",)): Published("(3.7)", _quadratic("w", 0.0166, -3.3197e-4, 1.9812e-5)),
    ("stiffness", ("w",)): Published("(3.8)", _quadratic("w", 3.0857, 0.1361, 0.0003)),
    ("damping", ("l",)): Published("(3.9)", _quadratic("l", 3.6381, -0.0297, 8.3506e-5)),
    ("stiffness", ("l",)): Published("(3.10)", _quadratic("l", 746.6667, -7.4590, 0.0251)),
    ("damping", ("a", "l", "w")): Published(
        "(3.11)",
        {
            ("a", 2): -0.8565, ("a", 1): 0.0129, ("l", 2): 2.0822, ("l", 1): -0.0227,
            ("w", 2): 0.0408, ("w", 1): -0.0023, CONSTANT: 5.0855e-5,
        },
        mae=2.39e-6,
        mae_percent=4.01,
    ),
    ("stiffness", ("l", "w")): Published(
        "(3.12)",
        {("l", 2): 762.5397, ("l", 1): -7.5305, ("w", 2): -1.4444, ("w", 1): 0.4298, CONSTANT: 0.0073},
        mae=2.59e-4,
        mae_percent=1.39,
    ),
}  # fmt: skip
NOMINAL = {"a": 43e-4, "l": 1.75e-3, "w": 50e-3}
"""The specimen at which the published maps agree; the single-variable ones hold for it only. Inferred, not printed."""
PUBLISHED_RANGE = {"a": (2e-4, 100e-4), "l": (1e-3, 5e-3), "w": (10e-3, 60e-3)}
"""Sizes between which the published maps may be read."""
_NEARLY = 0.02
"""Relative difference up to which a size counts as nominal."""
_EDGE = 1e-6


@dataclass(frozen=True, slots=True)
class Form:
    """The polynomial that is fitted to one quantity.

    Attributes
    ----------
    variables
        Those it depends on, in the order of `VARIABLES`.
    terms
        Squares and first powers of each, and the constant, as in (3.11).
    published
        The source's map of this quantity over the same variables; None if it has none.
    """

    quantity: Quantity
    variables: tuple[str, ...]
    terms: tuple[Term, ...]
    published: Published | None

    @classmethod
    def of(cls, quantity: Quantity, variables: Sequence[str], straight: Sequence[str] = ()) -> "Form":
        """Return the source's form; variables of `straight`, of two sizes only, have no square."""
        ordered = tuple(name for name in VARIABLES if name in variables)
        terms = [(name, power) for name in ordered for power in (2, 1) if power == 1 or name not in straight]
        return cls(quantity, ordered, (*terms, CONSTANT), PUBLISHED.get((quantity, ordered)))

    @property
    def symbol(self) -> str:
        """The letter of the quantity, k or b."""
        return SYMBOLS[self.quantity]

    @property
    def label(self) -> str:
        """Such as "b(a, l, w)", with the equation's number where the source has this map."""
        number = f" {self.published.equation}" if self.published is not None else ""
        return f"{self.symbol}({', '.join(self.variables)}){number}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients: b_w2 multiplies w^2 in b, b_0 is the constant."""
        return tuple(f"{self.symbol}_{name}{power if power != 1 else ''}" for name, power in self.terms)

    def published_value(self, sizes: Mapping[str, float]) -> float:
        """Return the published map's value at a specimen; nan if there is none or it may not be read there.

        It may not outside of the sizes it was fitted to, and one over a single size not for hinges or bodies that are
        not nominal otherwise.
        """
        if self.published is None or not self._readable(sizes):
            return float("nan")
        return self.published.value(sizes)

    def _readable(self, sizes: Mapping[str, float]) -> bool:
        inside = all(
            PUBLISHED_RANGE[name][0] * (1 - _EDGE) <= sizes[name] <= PUBLISHED_RANGE[name][1] * (1 + _EDGE)
            for name in self.variables
        )
        # k depends on the hinge only, whatever hangs on it
        others = [
            name
            for name in NOMINAL
            if name not in self.variables and not (name == "a" and self.quantity == "stiffness")
        ]
        return inside and all(abs(sizes[name] / NOMINAL[name] - 1) <= _NEARLY for name in others)

    def unit(self, term: Term) -> str:
        """Return the unit of a coefficient."""
        unit = UNITS[self.quantity]
        return unit if term == CONSTANT else f"{unit}/{_POWER_UNITS[term]}"


def design(terms: Sequence[Term], sizes: Mapping[str, FloatArray]) -> FloatArray:
    """Return the values of the terms, shape (n, terms), of sizes of shape (n,) in whatever units."""
    count = len(next(iter(sizes.values())))
    return np.column_stack([sizes[name] ** power if name else np.ones(count) for name, power in terms])
