"""Shares with their intervals, and how well stated probabilities come true."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Share:
    """So many hits of so many."""

    hits: int
    of: int

    @classmethod
    def among(cls, found: Iterable[bool]) -> "Share":
        """Count what is true."""
        every = list(found)
        return cls(sum(every), len(every))

    @property
    def value(self) -> float | None:
        """The share; None of nothing."""
        return self.hits / self.of if self.of else None

    @property
    def ci95(self) -> tuple[float, float] | None:
        """Exact 95 % interval (Clopper and Pearson, Biometrika 26, 1934); None of nothing."""
        if not self.of:
            return None
        from scipy.stats import binomtest

        interval = binomtest(self.hits, self.of).proportion_ci(0.95, method="exact")
        return float(interval.low), float(interval.high)

    def to_json(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        interval = self.ci95
        return {
            "share": self.value,
            "hits": self.hits,
            "of": self.of,
            "ci95": None if interval is None else list(interval),
        }


@dataclass(frozen=True, slots=True)
class Bin:
    """Causes whose stated confidence lies in one tenth.

    Attributes
    ----------
    stated
        Mean of what was stated.
    right
        The share that was right.
    by_chance
        Mean of |stated - right| if each cause were right with the very probability that is stated.
    """

    low: float
    high: float
    stated: float
    right: Share
    by_chance: float


@dataclass(frozen=True, slots=True)
class Reliability:
    """Stated confidence against what came true, tenth by tenth; tenths that nothing fell into are left out."""

    bins: tuple[Bin, ...]

    @property
    def error(self) -> float | None:
        """Expected calibration error: |stated - right|, weighed by how often (Naeini et al., AAAI 2015)."""
        return self._weighed(abs(one.stated - one.right.hits / one.right.of) for one in self.bins)

    @property
    def error_by_chance(self) -> float | None:
        """Mean of that error if every stated confidence were exactly true: few cases cannot show a smaller one."""
        return self._weighed(one.by_chance for one in self.bins)

    def _weighed(self, errors: Iterable[float]) -> float | None:
        total = sum(one.right.of for one in self.bins)
        if not total:
            return None
        return sum(one.right.of * error for one, error in zip(self.bins, errors, strict=True)) / total

    def to_json(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return {
            "expected_calibration_error": self.error,
            "by_chance": self.error_by_chance,
            "table": [
                {"from": one.low, "to": one.high, "stated": one.stated, "right": one.right.to_json()}
                for one in self.bins
            ],
        }


def reliability(stated: Sequence[tuple[float, bool]], bins: int = 10) -> Reliability:
    """Sort (confidence, was right) into equally wide bins.

    Raises
    ------
    ValueError
        A confidence outside of 0 to 1.
    """
    sorted_in: list[list[tuple[float, bool]]] = [[] for _ in range(bins)]
    for confidence, right in stated:
        if not 0.0 <= confidence <= 1.0:
            raise ValueError(f"a confidence of {confidence} is no probability")
        sorted_in[min(int(confidence * bins), bins - 1)].append((confidence, right))
    return Reliability(
        tuple(
            Bin(
                place / bins,
                (place + 1) / bins,
                sum(confidence for confidence, _ in members) / len(members),
                Share.among(right for _, right in members),
                _by_chance([confidence for confidence, _ in members]),
            )
            for place, members in enumerate(sorted_in)
            if members
        )
    )


def _by_chance(confidences: Sequence[float]) -> float:
    """Return the mean distance of the share of hits from the mean of their probabilities, exactly."""
    chances = np.ones(
        1
    )  # of 0, 1, ... hits: one more factor for each cause (Poisson's binomial distribution)
    for confidence in confidences:
        chances = np.convolve(chances, (1.0 - confidence, confidence))
    count = len(confidences)
    distances = np.abs(np.arange(count + 1) / count - sum(confidences) / count)
    return float(chances @ distances)
