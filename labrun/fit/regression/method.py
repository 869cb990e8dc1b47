"""The fit least-squares: every set of terms regressed on every output, and which one to take."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, NonNegativeFloat, PositiveFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.estimate import Estimate, rounded
from labrun.fit.method import FitJob, WithSettings
from labrun.fit.result import Curve, FigureData, FitSummary, FittedData, Panel, Role, Stack, TextTable
from labrun.fit.signals import SignalSet, SignalTable, SignalTrial, joined, load_signals, trailing_mean
from labrun.fit.uncertainty import resample_trials
from labrun.toml import Keys, TableFaults, suggest

BASKETS: dict[str, list[str]] = {
    "a,b": ["a", "b"],
    "+a',b'": ["a", "b", "a'", "b'"],
    "+a'',b''": ["a", "b", "a'", "b'", "a''", "b''"],
    "+a^2,b^2": ["a", "b", "a^2", "b^2"],
    "+a^3,b^3": ["a", "b", "a^2", "b^2", "a^3", "b^3"],
    "+a^4,b^4": ["a", "b", "a^2", "b^2", "a^3", "b^3", "a^4", "b^4"],
    "a,a',a^2,b,b',b^2": ["a", "a'", "a^2", "b", "b'", "b^2"],
}
"""Those of Table 5.3."""
_FACTOR = re.compile(r"([A-Za-z_]\w*)('{0,4})(?:\^([1-9]))?")
_COLLINEAR = 1e-6
"""Singular values of the scaled columns below this share of the largest count as zero."""


def term_values(term: str, signals: Mapping[str, FloatArray], step_s: float) -> FloatArray:
    """Return a term's values, (n,); derivatives are per second, by central differences.

    Raises RequestError: a term that cannot be read, or a signal that is not among the inputs.
    """
    values = np.ones(len(next(iter(signals.values()))))
    for factor in term.replace(" ", "").split("*"):
        match = _FACTOR.fullmatch(factor)
        if match is None:
            raise RequestError(
                f"a basket has a term that cannot be read: {term!r}",
                hint="terms are like a, a', a'', a^2, a*b",
            )
        name, primes, power = match.groups()
        if name not in signals:
            raise RequestError(
                f"a basket's term {term!r} needs {name}, which is not among the inputs",
                hint=suggest(name, signals, kind="inputs"),
            )
        signal = signals[name]
        for _ in primes:
            signal = np.gradient(signal, step_s, edge_order=2)
        values = values * signal ** int(power or 1)
    return values


def coefficient_unit(term: str, output_unit: str, units: Mapping[str, str]) -> str:
    """Return the unit of a term's coefficient."""
    below = []
    seconds = 0
    for factor in term.replace(" ", "").split("*"):
        name, primes, power = _FACTOR.fullmatch(factor).groups()  # type: ignore[union-attr]
        below.append(f"{units.get(name, '1')}{'^' + power if power else ''}")
        seconds += len(primes) * int(power or 1)
    above = f" s{'^' + str(seconds) if seconds > 1 else ''}" if seconds else ""
    return f"{output_unit}{above}/{' '.join(below) if len(below) == 1 else '(' + ' '.join(below) + ')'}"


@dataclass(frozen=True, slots=True)
class Regression:
    """The least squares of one output on one set of terms.

    `mae_fold` (k,) holds the mean absolute error on each left-out group; `low` and `high` (p,) the 95 % intervals.
    """

    coefficients: FloatArray
    low: FloatArray
    high: FloatArray
    fitted: FloatArray
    mae: float
    rmse: float
    mae_fold: FloatArray
    aicc: float

    @property
    def cv(self) -> float:
        """Cross-validated mean absolute error."""
        return float(np.mean(self.mae_fold))

    @property
    def cv_error(self) -> float:
        """Its standard error over the groups."""
        return float(np.std(self.mae_fold, ddof=1) / np.sqrt(len(self.mae_fold)))


def condition(matrix: FloatArray) -> float:
    """Return cond(X'X) of unscaled columns as the square of cond(X), which does not lose digits by the product."""
    values = np.linalg.svd(matrix, compute_uv=False)
    return float("inf") if values[-1] <= 0 else float((values[0] / values[-1]) ** 2)


def solve(matrix: FloatArray, values: FloatArray, rcond: float = _COLLINEAR) -> FloatArray:
    """Return the least-squares coefficients of columns of any size, the shortest ones where they are collinear.

    `rcond`: singular values of the scaled columns below this share of the largest count as zero.
    """
    size = np.linalg.norm(matrix, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / size, values, rcond=rcond)[0] / size)


def collinear(matrix: FloatArray, names: Sequence[str]) -> tuple[int, list[str]]:
    """Return the rank of scaled columns, and which terms each lost direction consists of."""
    size = np.linalg.norm(matrix, axis=0)
    _, values, rows = np.linalg.svd(matrix / np.where(size > 0, size, 1.0), full_matrices=False)
    lost = values <= _COLLINEAR * values[0]
    messages = [
        " and ".join(name for name, share in zip(names, row, strict=True) if abs(share) > 0.1)
        for row in rows[lost]
    ]
    return int(np.count_nonzero(~lost)), messages


def regress(
    matrix: FloatArray, values: FloatArray, groups: NDArray[np.int64], rng: np.random.Generator
) -> Regression:
    """Fit, leave each group out in turn, and resample whole groups.

    Parameters
    ----------
    matrix : (n, p)
    values : (n,)
    groups : (n,)
        Number of the trial, or of the block of time, that a sample belongs to.
    """
    solution = solve(matrix, values)
    fitted = matrix @ solution
    left = values - fitted
    numbers = np.unique(groups)
    folds = []
    size = np.where((norm := np.linalg.norm(matrix, axis=0)) > 0, norm, 1.0)
    # in the scaled columns' singular directions; those that are lost stay where they are
    _, singular, rows = np.linalg.svd(matrix / size, full_matrices=False)
    kept = rows[singular > _COLLINEAR * singular[0]]
    basis = (matrix / size) @ kept.T
    information, score = [], []
    for number in numbers:
        out = groups == number
        folds.append(float(np.mean(np.abs(values[out] - matrix[out] @ solve(matrix[~out], values[~out])))))
        information.append(basis[out].T @ basis[out])
        score.append(basis[out].T @ left[out])
    draws = resample_trials(np.array(information), np.array(score), rng=rng).draws @ kept / size
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    # groups, not samples, count as independent: neighbouring samples share their noise
    count, free = len(numbers), len(kept) + 1
    square = float(np.mean(left**2))
    spare = count - free - 1
    aicc = count * np.log(max(square, 1e-300)) + 2 * free * count / spare if spare > 0 else float("inf")
    return Regression(
        solution,
        solution + np.minimum(low, 0.0),
        solution + np.maximum(high, 0.0),
        fitted,
        float(np.mean(np.abs(left))),
        float(np.sqrt(square)),
        np.array(folds),
        float(aicc),
    )


_ENDS = 4
_FEW = 3
"""Fewer trials than this are cut into blocks of time."""


class LeastSquaresSettings(Keys):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    inputs, outputs
        Signals by the names that terms and results have.
    baskets
        Lists of terms; those of Table 5.3 if none are given.
    units
        Of inputs whose unit is not recorded.
    intercept
        Whether each basket has a constant too.
    delay_s
        Regressors are taken from this long ago.
    average
        ``"cycle"``: each term is averaged over the last gait cycle, like cycle-averaged outputs are.
    rate_hz
        Of the time base.
    block_s
        Length of the blocks that are left out and resampled where there are fewer than three trials.
    largest_condition
        Of X'X: a basket above it is not taken.
    stated
        Coefficients known from elsewhere, by output and term; whether the intervals hold them is told.
    """

    inputs: Annotated[dict[str, SignalTable], Field(min_length=1)]
    outputs: Annotated[dict[str, SignalTable], Field(min_length=1)]
    baskets: Annotated[dict[str, Annotated[list[str], Field(min_length=1)]], Field(min_length=1)] = BASKETS
    units: dict[str, str] = Field(default_factory=dict)
    intercept: bool = False
    delay_s: NonNegativeFloat = 0.0
    average: Literal["none", "cycle"] = "cycle"
    rate_hz: PositiveFloat = 20.0
    block_s: PositiveFloat = 25.0
    largest_condition: PositiveFloat = 1e4
    stated: dict[str, dict[str, float]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _states_what_is_fitted(self) -> Self:
        terms = {term for basket in self.baskets.values() for term in basket}
        with TableFaults() as faults:
            for output, known in self.stated.items():
                if output not in self.outputs:
                    faults.add(("stated", output), suggest(output, self.outputs, kind="outputs"))
                for term in known.keys() - terms:
                    faults.add(("stated", output, term), f"no basket has the term {term!r}")
        return self


class LeastSquaresFit(WithSettings[LeastSquaresSettings]):
    """Eq. (5.4) with each basket on each output, and which one to take.

    The basket taken is, among those whose X'X is conditioned no worse than `largest_condition`, the one of fewest
    terms whose cross-validated error is within one standard error of the best of them, for every output.
    """

    Settings: ClassVar[type[BaseModel]] = LeastSquaresSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit every basket to every output.

        Raises
        ------
        RequestError
            Terms that cannot be read; an average over cycles of a gait that has none; several runs.
        FitError
            Too little data for three groups.
        """
        settings = self._settings
        if job.more:
            raise RequestError(
                "least-squares takes one run", hint="repeat its trials instead: [trial] repeats"
            )
        wanted = joined(settings.inputs, settings.outputs)
        data = load_signals(job.target, wanted, rate_hz=settings.rate_hz, check=job.check)
        groups = _groups(data, settings)
        raw, matrices = {}, {}
        for name, terms in settings.baskets.items():
            job.note(f"basket {name}")
            raw[name], matrices[name] = _matrix(data, terms, settings)
        measured = {
            o: np.concatenate([t.values[o][_skip(t, settings) :] for t in data.trials])
            for o in settings.outputs
        }
        solved = {
            output: {name: regress(matrices[name], values, groups, job.rng) for name in matrices}
            for output, values in measured.items()
        }
        conditions = {name: condition(values) for name, values in raw.items()}
        ranks = {name: collinear(values, settings.baskets[name]) for name, values in raw.items()}
        taken, best = _choice(settings, solved, conditions)
        return _summary(_Study(data, settings, measured, solved, conditions, ranks, taken, best))


@dataclass(frozen=True, slots=True)
class _Study:
    """Every basket on every output (output -> basket -> regression), how they are conditioned, and which to take."""

    data: SignalSet
    settings: LeastSquaresSettings
    measured: Mapping[str, FloatArray]
    solved: Mapping[str, Mapping[str, Regression]]
    conditions: Mapping[str, float]
    ranks: Mapping[str, tuple[int, list[str]]]
    taken: str
    best: str


def _skip(trial: SignalTrial, settings: LeastSquaresSettings) -> int:
    """Return how many samples at the beginning have no full history."""
    return round(settings.delay_s / trial.step_s) + _cycle(trial, settings)


def _cycle(trial: SignalTrial, settings: LeastSquaresSettings) -> int:
    if settings.average == "none":
        return 1
    if trial.period_s is None:
        raise RequestError(
            f"the gait of {trial.label} has no cycle to average over", hint='set average = "none"'
        )
    return max(1, round(trial.period_s / trial.step_s))


def _matrix(
    data: SignalSet, terms: Sequence[str], settings: LeastSquaresSettings
) -> tuple[FloatArray, FloatArray]:
    """Return the terms as they are, and as regressors: delayed, averaged, without the beginning of each trial."""
    plain, ready = [], []
    for trial in data.trials:
        signals = {name: trial.values[name] for name in settings.inputs}
        columns = [term_values(term, signals, trial.step_s) for term in terms]
        late, cycle = round(settings.delay_s / trial.step_s), _cycle(trial, settings)
        skip = _skip(trial, settings)
        if len(trial.time_s) <= skip + 2:
            raise FitError(f"{trial.label} is shorter than the delay and a cycle together")
        kept = [trailing_mean(column[: len(column) - late], cycle)[skip - late :] for column in columns]
        if settings.intercept:
            kept.append(np.ones(len(kept[0])))
        # one-sided differences at the ends would hide that b'' of a sine is a multiple of b
        plain.append(np.column_stack(columns)[_ENDS:-_ENDS])
        ready.append(np.column_stack(kept))
    return np.concatenate(plain), np.concatenate(ready)


def _groups(data: SignalSet, settings: LeastSquaresSettings) -> NDArray[np.int64]:
    """Return the group of each sample, which is left out or resampled as one: mounting, trial or block of time."""
    mountings = list(dict.fromkeys(trial.mounting for trial in data.trials))
    if len(mountings) >= _FEW:
        owners = [(mountings.index(t.mounting), len(t.time_s[_skip(t, settings) :])) for t in data.trials]
        return np.concatenate([np.full(count, owner) for owner, count in owners])
    numbers: list[NDArray[np.int64]] = []
    used = 0
    for trial in data.trials:
        time_s = trial.time_s[_skip(trial, settings) :]
        if len(data.trials) >= _FEW:
            here = np.zeros(len(time_s), dtype=np.int64)
        else:
            blocks = max(1, round((time_s[-1] - time_s[0]) / settings.block_s))
            here = np.arange(len(time_s)) * blocks // len(time_s)
        numbers.append(here + used)
        used = int(numbers[-1][-1]) + 1
    if used < _FEW:
        raise FitError(
            f"{data.name}: {used} block(s) of {settings.block_s:g} s are too few to cross-validate",
            hint="record longer, repeat the trial, or set a shorter block_s",
        )
    return np.concatenate(numbers)


def _choice(
    settings: LeastSquaresSettings,
    solved: Mapping[str, Mapping[str, Regression]],
    conditions: Mapping[str, float],
) -> tuple[str, str]:
    names = list(settings.baskets)

    def error(name: str) -> float:
        # each output counts by what share of its best error a basket has
        return float(
            np.mean(
                [of[name].cv / min(regression.cv for regression in of.values()) for of in solved.values()]
            )
        )

    best = min(names, key=error)
    sound = [name for name in names if conditions[name] <= settings.largest_condition] or [
        min(names, key=lambda name: conditions[name])
    ]
    leaders = {
        o: min((of[name] for name in sound), key=lambda regression: regression.cv) for o, of in solved.items()
    }
    fit_for_it = [
        name
        for name in sound
        if all(solved[o][name].cv <= lead.cv + lead.cv_error for o, lead in leaders.items())
    ]
    return min(fit_for_it or sound, key=lambda name: (len(settings.baskets[name]), error(name))), best


def _summary(study: _Study) -> FitSummary:
    data, settings, solved, taken = study.data, study.settings, study.solved, study.taken
    output_units = {name: data.units[name] for name in solved}
    units = {**data.units, **settings.units}
    terms = [*settings.baskets[taken], *["1"] * settings.intercept]
    parameters, tables = {}, []
    for output, of in solved.items():
        solution, unit = of[taken], output_units[output]
        for term, *numbers in zip(terms, solution.coefficients, solution.low, solution.high, strict=True):
            value, low, high = map(float, numbers)
            named = unit if term == "1" else coefficient_unit(term, unit, units)
            parameters[f"{output}: {term}"] = Estimate(value, (low, high), named)
        span = float(np.max(np.abs(study.measured[output])))
        rows = tuple(
            (
                name, f"{regression.mae:.4f}", f"{100 * regression.mae / span:.2f}",
            f"{regression.cv:.4f} +- {regression.cv_error:.4f}",
                f"{regression.aicc:.1f}" if np.isfinite(regression.aicc) else "-", f"{study.conditions[name]:.1e}",
                f"{study.ranks[name][0]}/{len(settings.baskets[name])}",
            )
            for name, regression in of.items()
        )  # fmt: skip
        header = ("basket", f"MAE {unit}", "MAE %", "cross-validated", "AICc", "cond X'X", "rank")
        tables.append(TextTable(f"{output} (% of its largest magnitude, {span:.3g})", header, rows))
    warnings = [f"{name}: collinear: {'; '.join(lost)}" for name, (_, lost) in study.ranks.items() if lost]
    whole = len(data.trials) >= _FEW
    resampled = f"blocks of time of about {settings.block_s:g} s, as there are fewer than {_FEW} trials"
    findings = (
        _reason(study),
        f"cross-validation and intervals leave out and resample whole {'trials' if whole else resampled}",
        *_without_aicc(study),
        *_beside_stated(study, parameters),
    )
    if whole and len(data.trials) < 5:
        warnings.append(f"intervals rest on {len(data.trials)} trials only and are coarse")
    if settings.average == "cycle" and any(output.average == "none" for output in settings.outputs.values()):
        warnings.append("regressors are averaged over a cycle, but not every output is")

    def stored(read: Callable[[Regression], Any]) -> dict[str, dict[str, Any]]:
        return {
            output: {name: read(regression) for name, regression in of.items()}
            for output, of in solved.items()
        }

    return FitSummary(
        "least-squares",
        f"basket {{{taken}}}",
        FittedData.of(data),
        parameters,
        {output: of[taken].rmse for output, of in solved.items()},
        output_units,
        tables=tuple(tables),
        findings=findings,
        warnings=tuple(warnings),
        details={
            "taken": taken,
            "best": study.best,
            "coefficients": stored(lambda solution: solution.coefficients.tolist()),
            "intervals": stored(lambda solution: [solution.low.tolist(), solution.high.tolist()]),
            "mae": stored(lambda solution: solution.mae),
            "condition": dict(study.conditions),
        },
        figure_data=lambda: _figure(study, output_units),
    )


def _without_aicc(study: _Study) -> list[str]:
    """Say why a basket has no AICc, if so."""
    without = [
        name for name, solution in next(iter(study.solved.values())).items() if not np.isfinite(solution.aicc)
    ]
    if not without:
        return []
    listed = ", ".join(f"{{{name}}}" for name in without)
    return [
        f"AICc of {listed} needs more trials (or blocks of time) than it has coefficients, by at least three"
    ]


def _beside_stated(study: _Study, parameters: Mapping[str, Estimate]) -> list[str]:
    """Say of every stated coefficient whether the interval holds it."""
    messages = []
    for output, known in study.settings.stated.items():
        for term, value in known.items():
            estimate = parameters.get(f"{output}: {term}")
            if estimate is None:
                continue  # of a basket that was not taken
            low, high = estimate.ci95
            text, *ends = rounded(estimate)
            interval = f"{text} ({' ... '.join(ends)}) {estimate.unit}"
            if low <= value <= high:
                messages.append(f"{output}: {term} = {interval} agrees with the stated {value:g}")
            else:
                off = f"{100 * (estimate.value / value - 1):+.1f} %" if value else f"{estimate.value:+.3g}"
                messages.append(
                    f"{output}: {term} = {interval} does not hold the stated {value:g}: it is off by {off}, more than "
                    "trials scatter; the bench differs from the stated law, or the law is not linear in these terms"
                )
    return messages


def _reason(study: _Study) -> str:
    settings, conditions, taken, best = study.settings, study.conditions, study.taken, study.best
    text = (
        f"take {{{taken}}}: of the baskets whose X'X is conditioned no worse than {settings.largest_condition:.0e}, "
        f"it has the fewest terms within one standard error of the best cross-validated error"
    )
    if sum(value <= settings.largest_condition for value in conditions.values()) < 2:
        text = (
            f"take {{{taken}}}: it alone is conditioned no worse than the limit set, {settings.largest_condition:.0e} "
            "(largest_condition); the limit decides here, not the errors"
        )
    if best == taken:
        return f"{text}; it is also the best of all"
    gains = ", ".join(f"{o} {100 * (1 - of[best].cv / of[taken].cv):.0f} %" for o, of in study.solved.items())
    near = "its X'X is near singular, so its coefficients hold for these inputs only"
    why = near if conditions[best] > settings.largest_condition else "the gain is within one standard error"
    return f"{text}. {{{best}}} has a lower cross-validated error ({gains}), but {why}"


def _figure(study: _Study, units: Mapping[str, str]) -> FigureData:
    """Return the first trial's outputs over time with the residual, and the errors of every set of terms."""
    taken, best, first = study.taken, study.best, study.data.trials[0]
    title = f"Terms regressed on {study.data.name}\ntaken: {{{taken}}}"
    title += "" if best == taken else f"; least error: {{{best}}}"
    shown: list[tuple[str, Role]] = [(taken, "fitted")]
    if best != taken:
        shown.insert(0, (best, "alternative"))
    time_s = first.time_s[_skip(first, study.settings) :]
    over_time, merits, count = [], [], len(time_s)
    ticks = tuple(f"{name}\ncond {value:.0e}" for name, value in study.conditions.items())
    for output, of in study.solved.items():
        values, unit = study.measured[output][:count], units[output]
        fitted = [Curve(time_s, of[name].fitted[:count], role, name) for name, role in shown]
        curves = (Curve(time_s, values, "measured", "measured", bold=True), *fitted)
        upper = Panel(curves, title=f"{output}, first trial", y_label=f"{output}, {unit}", height=2.0)
        rest = tuple(Curve(time_s, values - curve.y, curve.role) for curve in fitted)
        lower = Panel(rest, x_label="time, s", y_label=f"residual, {unit}", zero=True)
        over_time.append(Stack((upper, lower), width=1.4))
        at = np.arange(len(of), dtype=float)
        mae, cv, error = (
            np.array([getattr(regression, key) for regression in of.values()])
            for key in ("mae", "cv", "cv_error")
        )
        bars = (
            Curve(at - 0.2, mae, "measured", "MAE", kind="bars"),
            Curve(at + 0.2, cv, "residual", "cross-validated", kind="bars", spread=(cv - error, cv + error)),
        )
        top, label = 1.45 * float(np.max(cv + error)), f"mean absolute error, {unit}"
        merits.append(Stack((Panel(bars, y_label=label, y_range=(0.0, top), ticks=ticks),), width=1.4))
    return FigureData(title, (tuple(over_time), tuple(merits)), row_height_in=4.0)
