"""A fitted number with its interval and significant digits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

_PLAIN = (1e-4, 1e7)
_NOT_NOTHING = 5e-3
"""Part of an interval's largest number from which a number is not written as 0."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted number with its 95 % interval, in its unit; an interval without width means unknown."""

    value: float
    ci95: tuple[float, float]
    unit: str

    @property
    def known(self) -> bool:
        """Tell whether there is an interval: one specimen has none."""
        return self.ci95[0] < self.ci95[1]

    @property
    def contains_zero(self) -> bool:
        """Tell whether the interval contains zero."""
        return self.ci95[0] <= 0.0 <= self.ci95[1]


def parameters_json(parameters: Mapping[str, Estimate]) -> dict[str, Any]:
    """Return estimates as ``labrun fit --json`` prints them."""
    return {
        name: {
            "value": estimate.value,
            "ci95": list(estimate.ci95) if estimate.known else None,
            "unit": estimate.unit,
        }
        for name, estimate in parameters.items()
    }


def outside_text(value: float, low: float, high: float) -> str:
    """Return a value that is outside of bounds with as many digits, four or more, as show that it is."""
    for digits in range(4, 17):
        text = f"{value:.{digits}g}"
        if not low <= float(text) <= high:
            return text
    return repr(value)


def rounded(estimate: Estimate) -> tuple[str, str, str]:
    """Return value and interval with the digits the interval supports: two of its half-width."""
    low, high = estimate.ci95
    half = 0.5 * (high - low)
    if half <= 0 or not np.isfinite(half):
        return f"{estimate.value:.6g}", f"{low:.6g}", f"{high:.6g}"
    largest = max(abs(estimate.value), abs(low), abs(high))
    digits = int(np.clip(np.floor(np.log10(largest)) - np.floor(np.log10(half)) + 2, 2, 9))
    if 1e-3 <= largest < 1e6:
        decimals = int(digits - 1 - np.floor(np.log10(largest)))

        def shown(number: float) -> str:
            text = f"{round(number, decimals) + 0.0:.{max(decimals, 0)}f}"  # no -0
            vanishes = float(text) == 0.0 and abs(number) >= _NOT_NOTHING * largest
            return significant(number, 1) if vanishes else text

        return shown(estimate.value), shown(low), shown(high)
    return f"{estimate.value:.{digits - 1}e}", f"{low:.{digits - 1}e}", f"{high:.{digits - 1}e}"


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, without an exponent where it is of usual size: 8000, 0.012."""
    text = f"{value:.{digits}g}"
    if not math.isfinite(value) or not _PLAIN[0] <= abs(value) < _PLAIN[1]:
        return text
    return f"{float(text):.0f}" if "e" in text else text
