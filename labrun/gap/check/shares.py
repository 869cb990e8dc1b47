"""Shares with their intervals, and how well stated probabilities come true."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any


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
    """Causes whose stated confidence lies in one tenth: the mean of what was stated, and the share that was right."""

    low: float
    high: float
    stated: float
    right: Share


@dataclass(frozen=True, slots=True)
class Reliability:
    """Stated confidence against what came true, tenth by tenth; tenths that nothing fell into are left out."""

    bins: tuple[Bin, ...]

    @property
    def error(self) -> float | None:
        """Expected calibration error: |stated - right|, weighed by how often (Naeini et al., AAAI 2015)."""
        total = sum(one.right.of for one in self.bins)
        if not total:
            return None
        return (
            sum(one.right.of * abs(one.stated - one.right.hits / one.right.of) for one in self.bins) / total
        )

    def to_json(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return {
            "expected_calibration_error": self.error,
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
            )
            for place, members in enumerate(sorted_in)
            if members
        )
    )
