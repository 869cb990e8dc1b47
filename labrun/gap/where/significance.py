"""Whether a part stands out from noise: redrawn, and recalibrated as the residual was."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria, numerics
from labrun.gap.where.difference import Difference
from labrun.gap.where.parts import Part


@dataclass(frozen=True)
class _Basis:
    """Directions that are orthonormal once they are whitened.

    Attributes
    ----------
    white : (rows, k)
        Orthonormal.
    plain : (rows, k)
        The same before whitening.
    """

    white: FloatArray
    plain: FloatArray


class NuisanceSubspace:
    """What recalibration can imitate: its least squares, linearised, in its own weights (white noise of a unit's mean).

    Initial states change one unit each: they are taken out unit by unit, and what all units share after that.

    Parameters
    ----------
    difference
        Its `jacobian` says what recalibration can do. All arrays here are in units of `Difference.noise_sd`.
    """

    def __init__(self, difference: Difference) -> None:
        self._whitener = difference.noise.whitener
        self._roots = [float(np.sqrt(unit.count)) for unit in difference.units.trials]
        self._shapes = [residual.shape for residual in difference.residual]
        sizes = [residual.size for residual in difference.residual]
        self._ends = np.cumsum(sizes)[:-1]
        none = np.empty((sum(sizes), 0)) if difference.jacobian is None else difference.jacobian
        parts = [
            part / np.tile(difference.noise_sd, shape[0])[:, None]
            for part, shape in zip(np.split(none, self._ends), self._shapes, strict=True)
        ]
        moves = np.array([np.any(part != 0, axis=0) for part in parts]).reshape(len(parts), -1)
        single = moves.sum(axis=0) == 1
        self._own = [
            self._basis_of_unit(part[:, single & moving], unit)
            for unit, (part, moving) in enumerate(zip(parts, moves, strict=True))
        ]
        self._shared = self._basis_of_all([part[:, moves.any(axis=0) & ~single] for part in parts])

    @property
    def rank(self) -> int:
        """Number of directions that recalibration has."""
        return int(sum(nuisance.white.shape[1] for nuisance in self._own) + self._shared.white.shape[1])

    @property
    def span(self) -> FloatArray:
        """All directions of the white world, orthonormal columns, (all numbers, rank)."""
        from scipy.linalg import block_diag

        return np.concatenate(
            [block_diag(*[nuisance.white for nuisance in self._own]), self._shared.white], axis=1
        )

    def white(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return values of every unit (n, m) as white noise of standard deviation 1, in one vector."""
        return np.concatenate([self._white(value, unit) for unit, value in enumerate(values)])

    def left(self, values: Sequence[FloatArray]) -> list[FloatArray]:
        """Return what recalibration leaves of values of every unit (n, m)."""
        if self.rank == 0:
            return list(values)
        white = [self._white(value, unit) for unit, value in enumerate(values)]
        along = [own.white.T @ whitened for own, whitened in zip(self._own, white, strict=True)]
        # what is shared is orthogonal to what is each unit's own
        together = self._shared.plain @ (self._shared.white.T @ np.concatenate(white))
        return [
            value - (own.plain @ size + part).reshape(value.shape)
            for value, own, size, part in zip(
                values, self._own, along, np.split(together, self._ends), strict=True
            )
        ]

    def _white(self, values: FloatArray, unit: int) -> FloatArray:
        return self._whitener.white(values.reshape(self._shapes[unit])).ravel() * self._roots[unit]

    def _whitened(self, columns: FloatArray, unit: int) -> FloatArray:
        if columns.shape[1] == 0:
            return columns
        return np.stack([self._white(column, unit) for column in columns.T], axis=1)

    def _basis_of_unit(self, columns: FloatArray, unit: int) -> _Basis:
        return _basis(self._whitened(columns, unit), columns)

    def _basis_of_all(self, parts: Sequence[FloatArray]) -> _Basis:
        white, plain = [], []
        for unit, (own, part) in enumerate(zip(self._own, parts, strict=True)):
            whitened = self._whitened(part, unit)
            along = own.white.T @ whitened
            white.append(whitened - own.white @ along)
            plain.append(part - own.plain @ along)
        return _basis(np.concatenate(white), np.concatenate(plain))


def _basis(white: FloatArray, plain: FloatArray) -> _Basis:
    """Return orthonormal directions of whitened columns, without what is only rounding."""
    norms = np.linalg.norm(white, axis=0)
    kept = norms > numerics.SPANNED * float(np.max(norms, initial=0.0))
    if not np.any(kept):
        return _Basis(white[:, :0], plain[:, :0])
    left, singular, right = np.linalg.svd(white[:, kept] / norms[kept], full_matrices=False)
    rank = singular > numerics.SPANNED * singular[0]
    return _Basis(left[:, rank], (plain[:, kept] / norms[kept]) @ (right[rank].T / singular[rank]))


Densities = Callable[[Sequence[FloatArray]], dict[str, FloatArray]]
"""Takes scaled residuals of every unit, and returns the density of each view."""

_LEAST_SPREAD = 1e-9
"""Spread below which draws do not scatter."""
_NEXT_TO_NONE = 1e-9
"""Least share, and least distance from the whole, of which log odds are taken."""
_AS_GOOD_AS_KNOWN = 1e9
"""Degrees of freedom of a variance that is as good as known."""
_TRIALS = 60
"""Redrawn trials that the scatter of a variance is taken from."""


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
        if self.quiet or (not np.any(self.p <= criteria.STANDS_OUT) and np.any(self.total <= 0)):
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
    relative = not difference.noise.known
    sums = _Sums(parts)
    measured_densities, whole = sums.of(densities(difference.scaled))
    noise, noise_whole = _null(difference, sums, densities, rng, draws)
    expected, expected_whole = noise.mean(axis=0), noise_whole.mean(axis=0)
    excess = measured_densities if relative else measured_densities - expected
    total = whole if relative else whole - expected_whole
    if relative:
        observed, null = measured_densities / _positive(whole), noise / _positive(noise_whole)
    else:
        observed, null = measured_densities, noise
    root, roots = _normal(observed, relative), _normal(null, relative)
    # what is observed counts as one draw more, so that under noise alone all of them are alike
    every = np.concatenate([root[None], roots])
    z = (every - every.mean(axis=0)) / np.maximum(every.std(axis=0), _LEAST_SPREAD)
    largest = np.max(z[1:], axis=1)
    p = (1.0 + np.sum(largest[:, None] >= z[:1], axis=0)) / (draws + 1.0)
    above = np.mean(noise_whole[:, 0] >= whole[0])
    quiet = not relative and bool(above > criteria.STANDS_OUT and not np.any(p <= criteria.STANDS_OUT))
    return Finding(excess, total, expected / _positive(expected_whole), p, quiet)


def _normal(values: FloatArray, relative: bool) -> FloatArray:
    """Return sums of squares, or shares of a sum, in a measure in which noise is nearly normal."""
    if not relative:
        return np.asarray(np.cbrt(values), dtype=float)
    inside = np.clip(values, _NEXT_TO_NONE, 1.0 - _NEXT_TO_NONE)
    return np.asarray(np.log(inside / (1.0 - inside)), dtype=float)


class _Sums:
    """Sums of densities over parts, and over all of the view of each."""

    def __init__(self, parts: Sequence[Part]) -> None:
        from scipy.sparse import csr_matrix

        self._count = len(parts)
        self._views = [name for name in ("time", "frequency") if any(part.view == name for part in parts)]
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
    drawn_densities = [
        sums.of(densities([residual * size for residual in drawn]))
        for drawn in redrawn(difference, rng, draws)
    ]
    return np.stack([draw for draw, _ in drawn_densities]), np.stack([draw for _, draw in drawn_densities])


def redrawn(difference: Difference, rng: np.random.Generator, draws: int) -> Iterator[list[FloatArray]]:
    """Yield noise of every unit's mean, (n, m) in units of one trial's noise, less what recalibration takes out."""
    nuisance = NuisanceSubspace(difference)
    sd = difference.noise.sd
    known = _freedom(difference, rng) if draws else sd
    for _ in range(draws):
        # the noise was estimated from few repeats, and may be larger than the estimate
        size = np.sqrt(known / rng.chisquare(known)) / sd
        yield nuisance.left(
            [residual * size for residual in difference.noise.draw(difference.units, rng, cautious=True)]
        )


def _freedom(difference: Difference, rng: np.random.Generator) -> FloatArray:
    """Return the degrees of freedom of each channel's noise variance, shape (m,).

    How much the variance of one trial's noise scatters is taken from redrawn noise, which has its colour. Many repeats
    are redrawn from their own deviations, whose squares scatter more than enough already.
    """
    noise, units = difference.noise, difference.units
    if noise.basis != "repeats" or noise.freedom >= criteria.ENOUGH_FREEDOM:
        return np.full(noise.sd.shape, _AS_GOOD_AS_KNOWN)
    squares = [
        np.mean(np.square(residual) * unit.count, axis=0) / noise.sd**2
        for _ in range(max(1, _TRIALS // len(units.trials)))
        for residual, unit in zip(noise.draw(units, rng, cautious=True), units.trials, strict=True)
    ]
    scatter = np.var(squares, axis=0) / max(noise.freedom, 1)
    return np.asarray(
        np.clip(2.0 / np.maximum(scatter, 2.0 / _AS_GOOD_AS_KNOWN), 1.0, _AS_GOOD_AS_KNOWN), dtype=float
    )


def _positive(values: FloatArray) -> FloatArray:
    return np.maximum(values, np.finfo(float).tiny)
