"""A polynomial through the specimens: coefficients with intervals, leave-one-out errors, conditioning."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from labrun.devices import FloatArray
from labrun.errors import FitError
from labrun.fit import LEVEL, Estimate, student

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
        crossings = {}
        for name, values in self.sizes.items():
            sizes, counts = np.unique(values, return_counts=True)
            crossings[name] = float(sizes[np.argmax(counts)])
        return crossings

    def line(self, name: str) -> dict[str, FloatArray]:
        """Return points along one size, between its smallest and its largest specimen, the others at the crossing."""
        own = np.linspace(float(self.sizes[name].min()), float(self.sizes[name].max()), _LINE)
        return {other: own if other == name else np.full(_LINE, at) for other, at in self.crossing.items()}

    def _rows(self, sizes: Mapping[str, FloatArray]) -> FloatArray:
        return design(self.form.terms, _scaled(sizes, self.form, self.centre, self.scale))


def fit_polynomial(
    form: Form, sizes: Mapping[str, FloatArray], releases: Sequence[FloatArray], *, rng: np.random.Generator
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
    index_of = {term: index for index, term in enumerate(terms)}
    matrix = np.zeros((len(terms), len(terms)))
    matrix[index_of[CONSTANT], index_of[CONSTANT]] = 1.0
    for (name, power), column in index_of.items():
        if not name:
            continue
        c, s = centre[name], scale[name]
        if power == 1:
            matrix[column, column] = 1.0 / s
            matrix[index_of[CONSTANT], column] = -c / s
        else:
            matrix[column, column] = 1.0 / s**2
            matrix[index_of[name, 1], column] = -2.0 * c / s**2
            matrix[index_of[CONSTANT], column] = c**2 / s**2
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
