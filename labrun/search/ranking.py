"""Orders of the same candidates on two benches: how far they agree, and which candidate to take."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.experiment import Condition
from labrun.notebook import as_reported
from labrun.search.leaders import t_interval

NUMBER = "gait"
"""The name under which conditions that were taken over from another run are numbered, from 1."""
_RESAMPLES = 2000
_EXACT_UP_TO = 8
"""8! = 40 320 orders are looked at one by one; of more candidates a sample of as many."""
_LEAST = 3
_SHARE = 0.95


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far two orders of the same candidates agree.

    Attributes
    ----------
    count
        Candidates.
    tau, spearman
        Kendall's tau-b and Spearman's rho: 1 for the same order, -1 for the reverse one.
    tau_p, spearman_p
        Share of all orders of one side that agree, or disagree, at least as much: two-sided.
    exact
        Whether all orders were looked at.
    tau_ci95, spearman_ci95
        95 % percentile intervals over resampled candidates and, within each, resampled trials.
    ties
        Pairs of candidates that are equal on one of the sides.
    """

    count: int
    tau: float
    tau_p: float
    tau_ci95: tuple[float, float]
    spearman: float
    spearman_p: float
    spearman_ci95: tuple[float, float]
    exact: bool
    ties: int

    @property
    def carries_over(self) -> bool:
        """Tell whether the interval of tau lies above zero: the order of one side says something about the other's."""
        return self.tau_ci95[0] > 0.0


@dataclass(frozen=True, slots=True)
class Cell:
    """One gait at one setting: its mean, with its 95 % interval (see `pooled_intervals`); None without two trials."""

    mean: float
    ci95: tuple[float, float] | None
    trials: int


@dataclass(frozen=True, slots=True)
class FieldColumn:
    """One setting of the field, and how far its order agrees with that of each laboratory run."""

    setting: Condition
    cells: tuple[Cell | None, ...]
    agreements: Mapping[str, Agreement | None]


@dataclass(frozen=True, slots=True)
class Ranking:
    """The gaits of a field run.

    Attributes
    ----------
    field, laboratories
        The runs.
    objective, unit
        What the field measured.
    gaits
        Each gait's number and values, in the order of the field run.
    laboratory_values
        Mean of each gait in each laboratory run; None where it was not measured there.
    columns
        One a setting of the field.
    winner
        Place of the gait whose lower bound in its worst setting is greatest; None where no gait has an interval in all.
    notes
        What else there is to say.
    laboratory_units
        Unit of the objective of each laboratory run.
    gait_units
        Of the values of the gaits.
    """

    field: str
    laboratories: tuple[str, ...]
    objective: str
    unit: str
    maximise: bool
    gaits: tuple[Condition, ...]
    laboratory_values: Mapping[str, tuple[float | None, ...]]
    columns: tuple[FieldColumn, ...]
    winner: int | None
    notes: tuple[str, ...]
    laboratory_units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    gait_units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def _repr_html_(self) -> str:
        return as_reported("ranking_text", self)

    def name(self, index: int) -> str:
        """Return the name of a gait."""
        return f"gait {self.gaits[index].get(NUMBER, index + 1):g}"

    def to_json(self) -> dict[str, Any]:
        """Return everything, JSON-ready."""
        data = {**asdict(self), "winner": None if self.winner is None else self.name(self.winner)}
        del data["maximise"]
        for column, own in zip(data["columns"], self.columns, strict=True):
            for name, agreed in own.agreements.items():
                if agreed is not None:
                    column["agreements"][name]["carries_over"] = agreed.carries_over
        return data

    def bound(self, column: FieldColumn, index: int) -> float | None:
        """Return the bound of a gait's interval that is farther from the goal; None without one."""
        cell = column.cells[index]
        if cell is None or cell.ci95 is None:
            return None
        return cell.ci95[0] if self.maximise else cell.ci95[1]


def agreement(
    first: Sequence[FloatArray], other: Sequence[FloatArray], rng: np.random.Generator
) -> Agreement | None:
    """Return how far two orders agree; None for fewer than three candidates, or where one side has no order at all.

    Parameters
    ----------
    first, other
        The values of each candidate's trials on either side, ordered alike.
    rng
        Of the resampling.

    Notes
    -----
    Kendall (1938), doi:10.2307/2332226, in the form b that allows for ties (Kendall 1945, doi:10.2307/2332303).
    P-values by permutation (`scipy.stats.permutation_test`), which ties do not make wrong. With few candidates the
    interval is wide, and has to be: eight candidates are eight.
    """
    from scipy import stats

    count = len(first)
    means = np.array([values.mean() for values in first]), np.array([values.mean() for values in other])
    if count < _LEAST or any(len(np.unique(side)) < 2 for side in means):
        return None
    exact = count <= _EXACT_UP_TO
    differences = []
    for statistic in (_tau, _rho):
        tested = stats.permutation_test(
            (means[0],),
            _against(statistic, means[1]),
            permutation_type="pairings",
            vectorized=True,
            n_resamples=math.factorial(_EXACT_UP_TO),  # all of them, where there are no more
            alternative="two-sided",
            rng=rng,
        )
        differences.append((float(tested.statistic), float(tested.pvalue)))
    intervals = _intervals(first, other, rng)
    ties = sum(math.comb(int(n), 2) for side in means for n in np.unique(side, return_counts=True)[1])
    return Agreement(
        count,
        differences[0][0],
        differences[0][1],
        intervals[0],
        differences[1][0],
        differences[1][1],
        intervals[1],
        exact,
        ties,
    )


def pooled_intervals(
    samples: Sequence[FloatArray], truncations: Sequence[float]
) -> list[tuple[float, float] | None]:
    """Return the 95 % t-interval of each candidate's mean at one setting; None where it has fewer than two trials.

    With a few trials each, a candidate's own scatter is mostly luck: an interval from it would be narrow or wide by
    chance, and choosing by its end would choose by that chance. So the variance is pooled over the candidates, as in an
    analysis of variance, unless they scatter differently: by the test of Brown and Forsythe (1974),
    doi:10.1080/01621459.1974.10482955, at 5 %; each then has its own.

    Parameters
    ----------
    samples
        The values of each candidate's trials.
    truncations
        What cut cycles do to all trials of each alike, see `t_interval`.
    """
    from scipy import stats

    several = [values for values in samples if len(values) >= 2]
    freedom = sum(len(values) - 1 for values in several)
    squares = sum(float(((values - values.mean()) ** 2).sum()) for values in several)
    unlike = False
    # of two trials it sees nothing
    if len(several) > 1 and squares > 0.0 and min(map(len, several)) >= _LEAST:
        with np.errstate(divide="ignore", invalid="ignore"):  # trials that are all alike
            unlike = bool(stats.levene(*several, center="median").pvalue < 1.0 - _SHARE)
    if unlike or not several:
        return [t_interval(values, (), cut) for values, cut in zip(samples, truncations, strict=True)]
    reach = float(stats.t.ppf(0.5 + _SHARE / 2, freedom)) * math.sqrt(squares / freedom)
    intervals: list[tuple[float, float] | None] = []
    for values, cut in zip(samples, truncations, strict=True):
        if len(values) < 2:
            intervals.append(None)
            continue
        mean, half = float(values.mean()), reach / math.sqrt(len(values)) + cut
        intervals.append((mean - half, mean + half))
    return intervals


def _against(
    statistic: Callable[[FloatArray, FloatArray], FloatArray], other: FloatArray
) -> Callable[..., FloatArray]:
    """Return a statistic of one side alone, as the permutation test calls it."""
    return lambda x, axis=-1: statistic(np.moveaxis(x, axis, -1), other)


def _tau(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return tau-b of the last axis of x, shape (..., n), with y, shape (n,) or (..., n)."""
    first, second = np.triu_indices(x.shape[-1], 1)
    a = np.sign(x[..., first] - x[..., second])
    b = np.sign(y[..., first] - y[..., second])
    scale = np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(axis=-1) / scale)


def _rho(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return Spearman's rho of the last axis, shapes as `_tau`."""
    from scipy import stats

    a, b = stats.rankdata(x, axis=-1), stats.rankdata(y, axis=-1)
    a, b = a - a.mean(axis=-1, keepdims=True), b - b.mean(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(axis=-1) / np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1)))


def _intervals(
    first: Sequence[FloatArray], other: Sequence[FloatArray], rng: np.random.Generator
) -> list[tuple[float, float]]:
    count = len(first)
    chosen = rng.integers(count, size=(_RESAMPLES, count))
    sides = []
    for values in (first, other):
        drawn = np.column_stack(
            [v[rng.integers(len(v), size=(_RESAMPLES, len(v)))].mean(axis=1) for v in values]
        )
        sides.append(np.take_along_axis(drawn, chosen, axis=1))
    tail = 100 * (1 - _SHARE) / 2
    intervals = []
    for statistic in (_tau, _rho):
        all_of_them = statistic(sides[0], sides[1])
        low, high = np.nanpercentile(all_of_them, [tail, 100 - tail])
        intervals.append((float(low), float(high)))
    return intervals
