"""How much of each part noise alone would hold, and how often noise does as much anywhere."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.gap.where.absorbed import Absorbed
from labrun.gap.where.difference import Difference
from labrun.gap.where.parts import Part

FloatArray = NDArray[np.float64]
Densities = Callable[[Sequence[FloatArray]], dict[str, FloatArray]]
"""Takes scaled residuals of every unit, and returns the density of each view."""

CERTAIN = 0.05
_LEAST_SPREAD = 1e-9
_LEAST_SHARE = 1e-9
_ENOUGH_FREEDOM = 8
_KNOWN = 1e9
_TRIALS = 60


@dataclass(frozen=True)
class Finding:
    """What was found about every part.

    Attributes
    ----------
    excess, total : (parts,)
        Of the squared residual over what noise leaves: in the part, and in all the data as the part's view has it.
    data_share : (parts,)
        Part of the noise's own squares that it holds: what its share would be if there were nothing special about it.
    p : (parts,)
        Corrected for all parts.
    quiet
        Whether all of the data hold no more than noise does.
    """

    excess: FloatArray
    total: FloatArray
    data_share: FloatArray
    p: FloatArray
    quiet: bool

    @property
    def share(self) -> FloatArray:
        """Of the total excess; 0 where there is none."""
        if self.quiet or (not np.any(self.p <= CERTAIN) and np.any(self.total <= 0)):
            return np.zeros_like(self.excess)
        largest = np.maximum(self.total, np.max(self.excess))
        return np.where(self.total > 0, self.excess / np.where(self.total > 0, self.total, largest), 0.0)


def weigh(
    difference: Difference, parts: Sequence[Part], densities: Densities, rng: np.random.Generator, draws: int
) -> Finding:
    """Compare every part with noise of the experiment, redrawn and recalibrated `draws` times.

    Sums of squares of noise are skewed the more the fewer independent numbers they hold; their cube roots are nearly
    normal (Wilson and Hilferty 1931), so that parts of different size can be compared. A part's p is the share of
    draws in which any part stands out as much (maximum statistic; Westfall and Young 1993).

    Where noise is only known from the residual itself, its size says nothing: shares of the whole, as log odds, then
    tell whether the residual is concentrated beyond chance.
    """
    relative = difference.noise.basis == "residual"
    sums = _Sums(parts)
    found, whole = sums.of(densities(difference.scaled))
    noise, noise_whole = _null(difference, sums, densities, rng, draws)
    expected, expected_whole = noise.mean(axis=0), noise_whole.mean(axis=0)
    excess = found if relative else found - expected
    total = whole if relative else whole - expected_whole
    if relative:
        observed, null = found / _positive(whole), noise / _positive(noise_whole)
    else:
        observed, null = found, noise
    root, roots = _normal(observed, relative), _normal(null, relative)
    # what is observed counts as one draw more, so that under noise alone all of them are alike
    every = np.concatenate([root[None], roots])
    z = (every - every.mean(axis=0)) / np.maximum(every.std(axis=0), _LEAST_SPREAD)
    largest = np.max(z[1:], axis=1)
    p = (1.0 + np.sum(largest[:, None] >= z[:1], axis=0)) / (draws + 1.0)
    above = np.mean(noise_whole[:, 0] >= whole[0])
    quiet = not relative and bool(above > CERTAIN and not np.any(p <= CERTAIN))
    return Finding(excess, total, expected / _positive(expected_whole), p, quiet)


def _normal(values: FloatArray, relative: bool) -> FloatArray:
    """Return sums of squares, or shares of a sum, in a measure in which noise is nearly normal."""
    if not relative:
        return np.asarray(np.cbrt(values), dtype=float)
    inside = np.clip(values, _LEAST_SHARE, 1.0 - _LEAST_SHARE)
    return np.asarray(np.log(inside / (1.0 - inside)), dtype=float)


class _Sums:
    """Sums of densities over parts, and over all of the view of each."""

    def __init__(self, parts: Sequence[Part]) -> None:
        from scipy.sparse import csr_matrix

        self._count = len(parts)
        self._views = [one for one in ("time", "frequency") if any(part.view == one for part in parts)]
        self._rows = {
            view: np.array([row for row, part in enumerate(parts) if part.view == view])
            for view in self._views
        }
        self._matrices = {
            view: csr_matrix(np.stack([parts[row].members for row in self._rows[view]]).astype(float))
            for view in self._views
        }

    def of(self, densities: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        sums, whole = np.zeros(self._count), np.zeros(self._count)
        for view in self._views:
            sums[self._rows[view]] = self._matrices[view] @ densities[view]
            whole[self._rows[view]] = densities[view].sum()
        return sums, whole


def _null(
    difference: Difference, sums: _Sums, densities: Densities, rng: np.random.Generator, draws: int
) -> tuple[FloatArray, FloatArray]:
    size = difference.noise_sd / difference.scale
    found = [sums.of(densities([one * size for one in drawn])) for drawn in redrawn(difference, rng, draws)]
    return np.stack([one for one, _ in found]), np.stack([one for _, one in found])


def redrawn(difference: Difference, rng: np.random.Generator, draws: int) -> Iterator[list[FloatArray]]:
    """Yield noise of every unit's mean, (n, m) in units of one trial's noise, less what recalibration takes out."""
    absorbed = Absorbed(difference)
    sd = difference.noise.sd
    known = _freedom(difference, rng) if draws else sd
    for _ in range(draws):
        # the noise was estimated from few repeats, and may be larger than the estimate
        size = np.sqrt(known / rng.chisquare(known)) / sd
        yield absorbed.left(
            [one * size for one in difference.noise.draw(difference.units, rng, cautious=True)]
        )


def _freedom(difference: Difference, rng: np.random.Generator) -> FloatArray:
    """Return the degrees of freedom of each channel's noise variance, shape (m,).

    How much the variance of one trial's noise scatters is taken from redrawn noise, which has its colour. Many repeats
    are redrawn from their own deviations, whose squares scatter more than enough already.
    """
    noise, units = difference.noise, difference.units
    if noise.basis == "residual" or noise.freedom >= _ENOUGH_FREEDOM:
        return np.full(noise.sd.shape, _KNOWN)
    squares = [
        np.mean(np.square(one) * unit.count, axis=0) / noise.sd**2
        for _ in range(max(1, _TRIALS // len(units.trials)))
        for one, unit in zip(noise.draw(units, rng, cautious=True), units.trials, strict=True)
    ]
    scatter = np.var(squares, axis=0) / max(noise.freedom, 1)
    return np.asarray(np.clip(2.0 / np.maximum(scatter, 2.0 / _KNOWN), 1.0, _KNOWN), dtype=float)


def _positive(values: FloatArray) -> FloatArray:
    return np.maximum(values, np.finfo(float).tiny)
