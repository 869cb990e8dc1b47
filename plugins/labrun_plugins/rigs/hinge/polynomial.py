"""A polynomial through the specimens: coefficients with intervals, leave-one-out errors, conditioning."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from labrun.devices import FloatArray
from labrun.errors import FitError
from labrun.fit import LEVEL, Estimate, student
from labrun_plugins.rigs.hinge.published import CONSTANT, Form, Term, design

RESAMPLES = 2000
_DEFICIENT = 1e-9
"""A singular value this much below the largest is zero: no specimens tell along that direction."""
_LEVERAGE = 1.0 - 1e-9
_VISIBLE = 1e-6
_LINE = 401


@dataclass(frozen=True, slots=True)
class FittedMap:
    """A polynomial of one quantity.

    Attributes
    ----------
    coefficients : (p,)
        In metres and square metres, in the order of `form.terms`.
    undetermined : (p,)
        Coefficients that the specimens leave open altogether.
    by_releases, by_scatter : (p, 2)
        Ends of 95 % intervals: from resampling whole releases within specimens; by Student's t from how far specimens
        lie off the map. nan where there is nothing to judge by: no specimen has a second release, or there are no more
        specimens than coefficients.
    measured, fitted : (n,)
        Of every specimen.
    left_out_error : (n,)
        Measured minus what the map through all others gives; nan where those do not determine it.
    scatter
        Standard deviation of specimens about the map; nan without a degree of freedom.
    release_scatter
        What of that the releases of a specimen account for.
    condition, raw_condition
        Condition number of the regressors, centred and scaled, and in the source's units.
    """

    form: Form
    sizes: Mapping[str, FloatArray]
    coefficients: FloatArray
    undetermined: NDArray[np.bool_]
    by_releases: FloatArray
    by_scatter: FloatArray
    measured: FloatArray
    fitted: FloatArray
    left_out_error: FloatArray
    freedom: int
    scatter: float
    release_scatter: float
    condition: float
    raw_condition: float
    draws: FloatArray
    covariance: FloatArray
    centre: Mapping[str, float]
    scale: Mapping[str, float]
    scaled: FloatArray

    @property
    def intervals(self) -> FloatArray:
        """Return the wider of both intervals, shape (p, 2): it holds what a mounting changes, where that shows."""
        ends = np.stack([self.by_releases, self.by_scatter])
        return np.column_stack([np.nanmin(ends[..., 0], axis=0), np.nanmax(ends[..., 1], axis=0)])

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Return the coefficients that are determined, in the source's units."""
        rows = zip(
            self.form.names,
            self.form.terms,
            self.coefficients,
            self.intervals,
            self.undetermined,
            strict=True,
        )
        return {
            name: Estimate(float(value), (float(low), float(high)), self.form.unit(term))
            for name, term, value, (low, high), open_ in rows
            if not open_
        }

    @property
    def mae(self) -> float:
        """Mean absolute error."""
        return float(np.mean(np.abs(self.measured - self.fitted)))

    def percent(self, error: float) -> float:
        """Return an error in % of the mean measured value, as the published ones seem to be."""
        return 100.0 * error / abs(float(np.mean(self.measured)))

    @property
    def left_out_mae(self) -> float:
        """Mean absolute error of specimens that the map did not know; nan if none can be left out."""
        known = self.left_out_error[np.isfinite(self.left_out_error)]
        return float(np.mean(np.abs(known))) if len(known) else float("nan")

    def value(self, sizes: Mapping[str, FloatArray]) -> FloatArray:
        """Return the map at sizes of shape (m,), m and m^2."""
        return np.asarray(self._rows(sizes) @ self.scaled)

    def band(self, sizes: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return the ends of the map's own 95 % interval, by the wider of both ways, shape (m,) each."""
        rows = self._rows(sizes)
        centre = rows @ self.scaled
        low, high = _ends(self.draws @ rows.T)
        if np.isfinite(self.scatter):
            spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, self.covariance, rows), 0.0))
            half = student(self.freedom) * self.scatter * spread
            low, high = np.fmin(low, -half), np.fmax(high, half)
        return centre + low, centre + high

    @property
    def crossing(self) -> dict[str, float]:
        """The size of every variable that most specimens share: where the lines of specimens cross."""
        found = {}
        for name, values in self.sizes.items():
            sizes, counts = np.unique(values, return_counts=True)
            found[name] = float(sizes[np.argmax(counts)])
        return found

    def line(self, name: str) -> dict[str, FloatArray]:
        """Return points along one size, between its smallest and its largest specimen, the others at the crossing."""
        own = np.linspace(float(self.sizes[name].min()), float(self.sizes[name].max()), _LINE)
        return {other: own if other == name else np.full(_LINE, at) for other, at in self.crossing.items()}

    def _rows(self, sizes: Mapping[str, FloatArray]) -> FloatArray:
        return design(self.form.terms, _scaled(sizes, self.form, self.centre, self.scale))


def fit_polynomial(
    form: Form,
    sizes: Mapping[str, FloatArray],
    releases: Sequence[FloatArray],
    *,
    rng: np.random.Generator,
) -> FittedMap:
    """Fit a form to the means of specimens by least squares, every specimen counting once, as in the source.

    Each variable is centred and scaled to -1 ... 1 for the solution, and the coefficients are turned back into the
    source's units: in metres and square metres the terms differ by up to nine orders of magnitude.

    Two things make the coefficients uncertain. Releases of one specimen differ: whole releases are resampled within
    every specimen, and the map is fitted again (deviations expanded for few releases, see
    `labrun.fit.resample_trials`). And specimens lie off the map by more than that, by how they are made
    and mounted: least squares' own interval, by Student's t with as many degrees of freedom as there are more
    specimens than coefficients. Both are given; `FittedMap.intervals` is the wider one.

    Parameters
    ----------
    sizes : variable -> (n,)
    releases : n times (m_i,)
        The quantity of every release of each specimen.

    Raises
    ------
    FitError
        One release a specimen, and no more specimens than coefficients.
    """
    used = {name: np.asarray(sizes[name], dtype=float) for name in form.variables}
    centre = {name: 0.5 * float(np.min(values) + np.max(values)) for name, values in used.items()}
    scale = {name: 0.5 * float(np.ptp(values)) or 1.0 for name, values in used.items()}
    matrix = design(form.terms, _scaled(used, form, centre, scale))
    measured = np.array([float(np.mean(values)) for values in releases])
    left, singular, right = np.linalg.svd(matrix, full_matrices=True)
    rank = int(np.count_nonzero(singular > _DEFICIENT * singular[0]))
    inverse = (right[:rank].T / singular[:rank]) @ left[:, :rank].T
    scaled = inverse @ measured
    back = _back(form.terms, centre, scale)
    fitted = matrix @ scaled
    residual = measured - fitted
    freedom = len(measured) - rank
    if freedom == 0 and all(len(values) == 1 for values in releases):
        raise FitError(
            f"{len(measured)} specimens with one release each say nothing about how sure {form.label} is",
            hint="release every specimen several times (the source: five), or measure more specimens",
        )
    covariance = inverse @ inverse.T
    scatter = float(np.sqrt(residual @ residual / freedom)) if freedom > 0 else float("nan")
    draws = _redrawn(releases, rng) @ inverse.T
    coefficients = back @ scaled
    half = (
        student(freedom) * scatter * np.sqrt(np.diag(back @ covariance @ back.T)) if freedom > 0 else np.nan
    )
    open_ = np.any(np.abs(back @ right[rank:].T) > _VISIBLE * np.linalg.norm(back, axis=1)[:, None], axis=1)
    leverage = np.diag(matrix @ inverse)
    with np.errstate(divide="ignore", invalid="ignore"):
        left_out = np.where(leverage < _LEVERAGE, residual / (1.0 - leverage), np.nan)
    raw = np.linalg.svd(design(form.terms, used), compute_uv=False)
    errors = [np.var(values, ddof=1) / len(values) for values in releases if len(values) > 1]
    return FittedMap(
        form, used, coefficients, open_,
        coefficients[:, None] + np.column_stack(_ends(draws @ back.T)),
        np.column_stack([coefficients - half, coefficients + half]),
        measured, fitted, left_out, freedom, scatter,
        float(np.sqrt(np.mean(errors))) if errors else float("nan"),
        float(singular[0] / max(singular[-1], 1e-300)), float(raw[0] / max(raw[-1], 1e-300)),
        draws, covariance, centre, scale, scaled,
    )  # fmt: skip


def _scaled(
    sizes: Mapping[str, FloatArray], form: Form, centre: Mapping[str, float], scale: Mapping[str, float]
) -> dict[str, FloatArray]:
    return {
        name: (np.asarray(sizes[name], dtype=float) - centre[name]) / scale[name] for name in form.variables
    }


def _back(terms: Sequence[Term], centre: Mapping[str, float], scale: Mapping[str, float]) -> FloatArray:
    """Return the matrix that turns coefficients of centred and scaled variables into those of the variables."""
    place = {term: index for index, term in enumerate(terms)}
    matrix = np.zeros((len(terms), len(terms)))
    matrix[place[CONSTANT], place[CONSTANT]] = 1.0
    for (name, power), column in place.items():
        if not name:
            continue
        c, s = centre[name], scale[name]
        if power == 1:
            matrix[column, column] = 1.0 / s
            matrix[place[CONSTANT], column] = -c / s
        else:
            matrix[column, column] = 1.0 / s**2
            matrix[place[name, 1], column] = -2.0 * c / s**2
            matrix[place[CONSTANT], column] = c**2 / s**2
    return matrix


def _redrawn(releases: Sequence[FloatArray], rng: np.random.Generator) -> FloatArray:
    """Return deviations of the specimens' means under resampling of their releases, shape (b, n)."""
    freedom = sum(len(values) - 1 for values in releases)
    deviations = np.zeros((RESAMPLES, len(releases)))
    if freedom == 0:
        return np.full_like(deviations, np.nan)
    quantile = 0.5 * (1.0 + LEVEL)
    expansion = student(freedom, quantile) / float(ndtri(quantile))
    for column, values in enumerate(releases):
        count = len(values)
        if count > 1:
            counts = rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
            about = values - np.mean(values)
            deviations[:, column] = expansion * np.sqrt(count / (count - 1)) * (counts @ about) / count
    return deviations


def _ends(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the 95 % interval of every column, relative to the estimate, which is always inside."""
    tail = 50.0 * (1.0 - LEVEL)
    low, high = np.percentile(draws, [tail, 100.0 - tail], axis=0)
    return np.minimum(low, 0.0), np.maximum(high, 0.0)
