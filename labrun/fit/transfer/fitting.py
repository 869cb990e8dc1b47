"""A transfer function fitted to trials: output error in continuous time, its starts, intervals, and other orders.

The denominator is a product of sections ``a2 s^2 + a1 s + 1`` (and one ``a1 s + 1`` if the order is odd) whose
coefficients are powers of e: every point of the search is stable, and every stable denominator is one of its points.
The numerator, the offsets and the initial states enter linearly, so the search moves the denominator and the dead time
only, and the others follow by least squares at every point (variable projection, Golub and Pereyra 1973).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import FitError
from labrun.estimate import Estimate
from labrun.fit.regression.method import solve
from labrun.fit.result import TextTable
from labrun.fit.signals import trailing_mean
from labrun.fit.transfer.transfer_function import Hold, TransferFunction, free_answers, powers
from labrun.fit.uncertainty import correlation_length, resample_trials

Initial = Literal["steady", "free"]
_SAME_DIRECTION = 1e-6
"""What adds less than this share of the largest direction is rounding: the free answers of poles far apart."""
_STEP = 1e-5
_MOST_DEAD = 0.3
"""A dead time is looked for up to this share of the longest trial."""
_DECADES_BEYOND = 1.5
"""Time constants are searched so many decades below the sampling step and beyond the longest trial."""
_DECADES_OF_A_LAG = 4.0
"""The same of a single lag: 10,000 times longer than the record it answers like an integrator."""
_AT_BOUND = 1e-3
"""A number within this of a bound of the search, in its own scale, ended there."""


@dataclass(frozen=True, slots=True)
class Shape:
    """What is looked for: its order, whether there is a dead time, and what each trial starts from.

    `initial`: the steady state of a trial's first input, or anything.
    """

    poles: int
    zeros: int
    dead_time: bool = True
    initial: Initial = "steady"

    @property
    def is_first_order(self) -> bool:
        """Tell whether it is a gain and a lag, with or without a dead time."""
        return (self.poles, self.zeros) == (1, 0)

    @property
    def moved(self) -> int:
        """How many numbers the search moves: the denominator's, and the dead time."""
        return self.poles + int(self.dead_time)

    @property
    def size(self) -> int:
        """How many numbers describe it; the numerator's follow from those moved by linear least squares."""
        return self.moved + self.zeros + 1

    def denominator(self, moved: FloatArray) -> tuple[float, ...]:
        """Return the denominator, its last coefficient 1."""
        product = np.ones(1)
        for index in range(0, self.poles - 1, 2):
            product = np.polymul(product, [np.exp(moved[index]), np.exp(moved[index + 1]), 1.0])
        if self.poles % 2:
            product = np.polymul(product, [np.exp(moved[self.poles - 1]), 1.0])
        return tuple(product.tolist())

    def dead_s(self, moved: FloatArray) -> float:
        """Return the dead time, s."""
        return max(float(moved[self.poles]), 0.0) if self.dead_time else 0.0

    def at(self, poles: NDArray[np.complex128], dead_s: float) -> FloatArray:
        """Return the point of a set of poles, unstable ones mirrored to the left, and of a dead time."""
        left = -np.abs(poles.real) + 1j * poles.imag
        left = np.where(left.real == 0.0, left - 1e-3 * np.abs(left) - 1e-9, left)
        pairs = sorted(left[left.imag > 1e-12], key=abs)
        single = sorted(left[np.abs(left.imag) <= 1e-12].real, key=abs)
        sections = [(abs(pair) ** 2, -2.0 * pair.real) for pair in pairs]
        while len(single) > 1:
            first, other = single.pop(0), single.pop(0)
            sections.append((first * other, -first - other))
        point = [np.log(value) for c, b in sections for value in (1.0 / c, b / c)]
        if single:
            point.append(np.log(-1.0 / single[0]))
        return np.array([*point, dead_s] if self.dead_time else point)


@dataclass(frozen=True, slots=True)
class ResponseTrial:
    """One trial: evenly spaced input and output.

    Attributes
    ----------
    label
        Names it in figures and messages.
    time_s, given, measured : (n,)
        `given` is the input, `measured` the output.
    used : (n,)
        Which samples the fit is made on.
    averaged
        Samples over which the output was averaged, each with those before it; 1 if it was not.
    hold
        How the input runs between its samples.
    """

    label: str
    time_s: FloatArray
    given: FloatArray
    measured: FloatArray
    used: NDArray[np.bool_]
    averaged: int = 1
    hold: Hold = "linear"

    @property
    def step_s(self) -> float:
        """Time between two samples."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    def average(self, columns: FloatArray) -> FloatArray:
        """Return columns averaged as the output was."""
        if self.averaged <= 1:
            return columns
        return np.column_stack([trailing_mean(column, self.averaged) for column in columns.T])


@dataclass(slots=True)
class Answers:
    """Answers of one candidate to every input, each computed once however many trials share it."""

    shape: Shape
    moved: FloatArray
    _known: dict[tuple[object, ...], FloatArray] = field(default_factory=dict)

    def _once(self, make: Callable[[], FloatArray], *key: object) -> FloatArray:
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def shared(self, trial: ResponseTrial) -> FloatArray:
        """Return what the numerator's coefficients (lowest power first) weigh, (n, linear)."""

        def make() -> FloatArray:
            denominator, dead_s = self.shape.denominator(self.moved), self.shape.dead_s(self.moved)
            before = float(trial.given[0])
            columns = powers(denominator, dead_s, trial.step_s, trial.given, trial.hold, before)
            return trial.average(columns[:, : self.shape.zeros + 1])

        return self._once(make, "shared", id(trial.given), trial.averaged)

    def own(self, trial: ResponseTrial) -> FloatArray:
        """Return what each trial's own numbers weigh: its offset and its initial state, (n, own)."""

        def make() -> FloatArray:
            columns = np.ones((len(trial.time_s), 1))
            if self.shape.initial == "steady":
                return columns
            free = free_answers(self.shape.denominator(self.moved), trial.step_s, len(trial.time_s))
            return np.column_stack([columns, trial.average(free)])

        return self._once(make, "own", len(trial.time_s), trial.averaged)

    def span(self, trial: ResponseTrial) -> FloatArray:
        """Return an orthonormal basis of `own` at the samples used, (n_used, k)."""
        key = (len(trial.time_s), trial.averaged, trial.used.tobytes())
        return self._once(lambda: basis(self.own(trial)[trial.used]), "span", *key)

    def projected(self, trial: ResponseTrial) -> FloatArray:
        """Return `shared` at the samples used, less its part in `own`, (n_used, linear)."""

        def make() -> FloatArray:
            return without(self.shared(trial)[trial.used], self.span(trial))

        return self._once(make, "projected", id(trial.given), trial.averaged, trial.used.tobytes())

    def best(self, trials: Sequence[ResponseTrial]) -> tuple[FloatArray, list[FloatArray]]:
        """Return the best numerator and every trial's residual, offsets and initial states projected out."""
        shared = [self.projected(trial) for trial in trials]
        outputs = [without(trial.measured[trial.used], self.span(trial)) for trial in trials]
        linear = solve(np.concatenate(shared), np.concatenate(outputs), rcond=1e-12)
        return linear, [y - x @ linear for x, y in zip(shared, outputs, strict=True)]


def basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the columns' span."""
    if columns.shape[1] == 0:
        return columns
    sizes = np.linalg.norm(columns, axis=0)
    u, singular, _ = np.linalg.svd(columns / np.where(sizes > 0, sizes, 1.0), full_matrices=False)
    return np.asarray(u[:, singular > _SAME_DIRECTION * singular[0]])


def without(columns: FloatArray, span: FloatArray) -> FloatArray:
    """Return columns less their part in an orthonormal basis."""
    return columns - span @ (span.T @ columns)


def total_s(trials: Sequence[ResponseTrial]) -> float:
    """Return the longest trial's duration."""
    return max(float(trial.time_s[-1] - trial.time_s[0]) for trial in trials)


@dataclass(frozen=True, slots=True)
class CandidatePoint:
    """A candidate with its least-squares partners.

    Attributes
    ----------
    moved, linear
        What the search moves, and what follows from it.
    own : one (k,) a trial
        Offset and initial state.
    residuals : one (n_used,) a trial
        Measured less simulated.
    """

    shape: Shape
    moved: FloatArray
    linear: FloatArray
    own: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    squares: float

    @property
    def numbers(self) -> FloatArray:
        """All that describes it: `moved`, then `linear`."""
        return np.concatenate([self.moved, self.linear])

    def simulated(self, trials: Sequence[ResponseTrial]) -> list[FloatArray]:
        """Return its answer to every trial, at all samples, offset and initial state included."""
        answers = Answers(self.shape, self.moved)
        return [
            answers.shared(trial) @ self.linear + answers.own(trial) @ own
            for trial, own in zip(trials, self.own, strict=True)
        ]


def transfer_of(shape: Shape, numbers: FloatArray, **names: str) -> TransferFunction:
    """Return the transfer function that numbers as of `CandidatePoint.numbers` describe."""
    moved, linear = numbers[: shape.moved], numbers[shape.moved :]
    numerator = tuple(float(coefficient) for coefficient in linear[: shape.zeros + 1][::-1])
    return TransferFunction(numerator, shape.denominator(moved), shape.dead_s(moved), **names)


def evaluate(shape: Shape, trials: Sequence[ResponseTrial], moved: FloatArray) -> CandidatePoint:
    """Return a candidate's best numerator, offsets and initial states."""
    answers = Answers(shape, moved)
    linear, residuals = answers.best(trials)
    own = []
    for trial in trials:
        rest = trial.measured[trial.used] - answers.shared(trial)[trial.used] @ linear
        own.append(solve(answers.own(trial)[trial.used], rest, rcond=_SAME_DIRECTION))
    squares = sum(float(part @ part) for part in residuals)
    return CandidatePoint(shape, np.array(moved, dtype=float), linear, tuple(own), tuple(residuals), squares)


def residuals_of(shape: Shape, trials: Sequence[ResponseTrial], moved: FloatArray) -> FloatArray:
    """Return what the best numerator, offsets and initial states leave of all trials."""
    return np.concatenate(Answers(shape, moved).best(trials)[1])


def descend(
    shape: Shape, trials: Sequence[ResponseTrial], start: FloatArray, evaluations: int = 60
) -> CandidatePoint:
    """Return the minimum that a start leads to."""
    from scipy.optimize import least_squares

    if shape.moved == 0:
        return evaluate(shape, trials, start)
    low, high = bounds(shape, trials)
    first = np.clip(start, low + 1e-9, high - 1e-9)

    def residuals(moved: FloatArray) -> FloatArray:
        return residuals_of(shape, trials, moved)

    solution = least_squares(
        residuals, first, bounds=(low, high), x_scale=_scales(shape, trials), xtol=1e-9, ftol=1e-11, gtol=1e-11,
        max_nfev=evaluations,
    )  # fmt: skip
    return min((evaluate(shape, trials, at) for at in (solution.x, first)), key=lambda point: point.squares)


def bounds(shape: Shape, trials: Sequence[ResponseTrial]) -> tuple[FloatArray, FloatArray]:
    """Return the box that is searched."""
    shortest, longest = np.log(_shortest_s(trials)), np.log(_longest_s(shape, trials))
    low, high = np.full(shape.moved, shortest), np.full(shape.moved, longest)
    for index in range(0, shape.poles - 1, 2):
        low[index], high[index] = 2.0 * shortest, 2.0 * longest
        # a section may be damped by next to nothing
        low[index + 1] -= 3.0 * np.log(10.0)
    if shape.dead_time:
        low[-1], high[-1] = 0.0, _MOST_DEAD * total_s(trials)
    return low, high


def _shortest_s(trials: Sequence[ResponseTrial]) -> float:
    """Return the shortest time constant that is looked for."""
    return float(min(trial.step_s for trial in trials) * 10.0**-_DECADES_BEYOND)


def _longest_s(shape: Shape, trials: Sequence[ResponseTrial]) -> float:
    """Return the longest time constant that is searched."""
    decades = _DECADES_OF_A_LAG if shape.is_first_order else _DECADES_BEYOND
    return float(total_s(trials) * 10.0**decades)


def derivatives(point: CandidatePoint, trials: Sequence[ResponseTrial]) -> list[FloatArray]:
    """Return d(simulated)/d(numbers) of every trial's used samples, offsets and initial states eliminated."""
    shape = point.shape
    moving = []
    for index, scale in enumerate(_scales(shape, trials)):
        ahead, behind, width = point.moved.copy(), point.moved.copy(), _STEP * scale
        at_bound = shape.dead_time and index == shape.poles and point.moved[index] < width
        ahead[index] += width
        behind[index] -= 0.0 if at_bound else width
        sides = [replace(point, moved=moved).simulated(trials) for moved in (ahead, behind)]
        moving.append([(a - b) / (ahead[index] - behind[index]) for a, b in zip(*sides, strict=True)])
    answers = Answers(shape, point.moved)
    filtered = []
    for index, trial in enumerate(trials):
        columns = [
            *(derivative[index][trial.used] for derivative in moving),
            answers.shared(trial)[trial.used],
        ]
        filtered.append(without(np.column_stack(columns), answers.span(trial)))
    return filtered


def _scales(shape: Shape, trials: Sequence[ResponseTrial]) -> FloatArray:
    """Return how far each number of the search moves before the answer looks different."""
    scales = np.ones(shape.moved)
    if shape.dead_time:
        scales[-1] = max(trial.step_s for trial in trials)
    return scales


STARTS = 3
_SPEEDS = 6
_REFINED = 6
_DEADS = (0.0, 0.5, 1.0, 3.0, 10.0)
"""Dead times to start from, in units of the time constant a start has."""
_BLOCKS = 10
_FARTHEST = 20.0
"""Draws of a logarithm are cut here: beyond it nothing is determined."""
_WORTH = 0.05
"""A fall of the error by less is not worth another number."""
_ROUNDING = 5e-4
"""An order may leave so much more than a smaller one, relatively, before its search counts as ended too early."""


@dataclass(frozen=True, slots=True)
class TransferFit:
    """A fitted transfer function.

    Attributes
    ----------
    point
        Its numbers, and what is left.
    draws : (b, size)
        Resampled numbers.
    resampled
        The transfer functions of those.
    blocks
        How many parts were resampled in place of trials; 0 if trials were.
    """

    shape: Shape
    trials: tuple[ResponseTrial, ...]
    point: CandidatePoint
    transfer: TransferFunction
    draws: FloatArray
    resampled: tuple[TransferFunction, ...]
    blocks: int

    @property
    def rmse(self) -> float:
        """Root mean square of measured less simulated, over the samples used."""
        rest = np.concatenate(self.residuals())
        return float(np.sqrt(np.mean(rest**2)))

    def residuals(self) -> list[FloatArray]:
        """Return measured less simulated of every trial's used samples."""
        pairs = zip(self.trials, self.point.simulated(self.trials), strict=True)
        return [(trial.measured - simulated)[trial.used] for trial, simulated in pairs]

    @property
    def record_s(self) -> float:
        """Length of the longest trial."""
        return total_s(self.trials)

    @property
    def upper_bounds_reached(self) -> NDArray[np.bool_]:
        """Tell of each number of the search, shape (moved,), whether it ended at its upper bound."""
        _, high = bounds(self.shape, self.trials)
        return np.asarray(high - self.point.moved <= _AT_BOUND * _scales(self.shape, self.trials))

    @property
    def lag_is_open(self) -> bool:
        """Tell whether the data bound the lag of a first-order fit from below only: an integrator fits as well."""
        if not self.shape.is_first_order:
            return False
        longest_s = (1.0 - _AT_BOUND) * _longest_s(self.shape, self.trials)
        return float(np.percentile([transfer.lag_s for transfer in self.resampled], 97.5)) >= longest_s

    def estimate(self, quantity: Callable[[TransferFunction], float], unit: str) -> Estimate:
        """Return any quantity of the transfer function with its 95 % interval."""
        values = [quantity(function) for function in self.resampled]
        value = quantity(self.transfer)
        low, high = np.percentile(values, [2.5, 97.5])
        return Estimate(value, (min(float(low), value), max(float(high), value)), unit)


def fit_transfer(
    trials: Sequence[ResponseTrial],
    shape: Shape,
    *,
    rng: np.random.Generator,
    starts: int = STARTS,
    **names: str,
) -> TransferFit:
    """Fit a transfer function of a given shape to trials, each evenly spaced; steps may differ.

    `rng` is that of the resamples; `names` are names and units, as of `TransferFunction`. Raises FitError: nothing
    moves, or too few samples.
    """
    point = best_fit(shape, trials, starts=starts)
    parts = list(zip(derivatives(point, trials), point.residuals, strict=True))
    blocks = _BLOCKS if len(parts) == 1 else 0
    if blocks:
        parts = list(zip(*(np.array_split(whole, blocks) for whole in parts[0]), strict=True))
    outlasts_record = shape.is_first_order and np.exp(point.numbers[0]) > total_s(trials)
    change = _by_rate_and_slope(point.numbers) if outlasts_record else np.eye(shape.size)
    information = np.array([change.T @ j.T @ j @ change for j, _ in parts])
    score = np.array([change.T @ j.T @ r for j, r in parts])
    drawn = resample_trials(information, score, rng=rng, resamples=1000).draws
    farthest = np.where(np.arange(shape.size) < shape.poles, _FARTHEST, np.inf)
    draws = point.numbers + np.clip(drawn, -farthest, farthest)
    if outlasts_record:
        draws = _drawn_by_rate_and_slope(point.numbers, drawn, _longest_s(shape, trials))
    fitted, *others = (transfer_of(shape, numbers, **names) for numbers in (point.numbers, *draws))
    return TransferFit(shape, tuple(trials), point, fitted, draws, tuple(others), blocks)


def _by_rate_and_slope(numbers: FloatArray) -> FloatArray:
    """Return d(numbers)/d(numbers with 1/lag and gain/lag in place of log(lag) and gain), (size, size).

    Of a lag beyond the record the data tell the slope gain/lag and how fast it falls off. The answer is nearly linear
    in these, and they are told apart; log(lag) and gain are not.
    """
    lag_s, gain = np.exp(numbers[0]), numbers[-1]
    change = np.eye(len(numbers))
    change[0, 0], change[-1, 0], change[-1, -1] = -lag_s, -gain * lag_s, lag_s
    return change


def _drawn_by_rate_and_slope(numbers: FloatArray, drawn: FloatArray, longest_s: float) -> FloatArray:
    """Return draws of a first-order fit's `numbers`, (b, size), from what draws add to its 1/lag and gain/lag.

    A draw whose answer does not fall off at all has the longest lag that is searched.
    """
    lag_s = np.exp(numbers[0])
    draws = numbers + drawn
    rates = np.maximum(1.0 / lag_s + drawn[:, 0], 1.0 / longest_s)
    draws[:, 0], draws[:, -1] = -np.log(rates), (numbers[-1] / lag_s + drawn[:, -1]) / rates
    return np.asarray(draws)


def best_fit(
    shape: Shape, trials: Sequence[ResponseTrial], *, starts: int = STARTS, near: Sequence[FloatArray] = ()
) -> CandidatePoint:
    """Return the best of the minima that the most promising starts lead to.

    Starts come from linear least squares on input and output filtered alike, at several speeds of the filter, which is
    then replaced by the denominator found (the refined method of Young and Jakeman 1980, without its noise model).

    `near` are starts that are followed besides. Raises FitError: an input or output that does not move, or fewer
    samples than numbers to be found.
    """
    _require(shape, trials)
    low, high = bounds(shape, trials)
    rated: list[tuple[float, int, FloatArray]] = []
    for moved in _candidates(shape, trials):
        inside = np.clip(moved, low, high)
        left = residuals_of(shape, trials, inside)
        squares = float(left @ left)
        if np.isfinite(squares):
            rated.append((squares, len(rated), inside))
    rated.sort(key=lambda pair: pair[:2])
    ends = [descend(shape, trials, moved) for _, _, moved in rated[: max(starts, 1)]]
    ends += [descend(shape, trials, start) for start in near]
    return min(ends, key=lambda end: end.squares)


def _require(shape: Shape, trials: Sequence[ResponseTrial]) -> None:
    if all(np.ptp(trial.given) == 0.0 for trial in trials):
        raise FitError(
            "the input does not change in any trial: nothing tells what the output answers to",
            hint="fit trials in which it moves; [fit.settings.responses.NAME] where = ... chooses them",
        )
    if all(np.ptp(trial.measured[trial.used]) == 0.0 for trial in trials if np.any(trial.used)):
        raise FitError("the output does not change in any trial", hint="is it the right channel?")
    count = sum(int(np.count_nonzero(trial.used)) for trial in trials)
    if count < 3 * (shape.size + len(trials)):
        raise FitError(f"{count} samples are too few for {shape.size} numbers", hint="fit fewer poles")


def _candidates(shape: Shape, trials: Sequence[ResponseTrial]) -> list[FloatArray]:
    step_s = min(trial.step_s for trial in trials)
    slowest = total_s(trials) / 3.0
    candidates = []
    for lag_s in np.geomspace(min(2.0 * step_s, slowest), slowest, _SPEEDS):
        for dead_s in (share * lag_s for share in (_DEADS if shape.dead_time else (0.0,))):
            poles = np.full(shape.poles, -1.0 / lag_s, dtype=complex)
            candidates.append(shape.at(poles, dead_s))
            for _ in range(_REFINED if shape.poles > 1 else 0):
                refined = _filtered_least_squares(shape, trials, poles, dead_s)
                if refined is None:
                    break
                poles = refined
                candidates.append(shape.at(poles, dead_s))
    return candidates


def _filtered_least_squares(
    shape: Shape, trials: Sequence[ResponseTrial], poles: NDArray[np.complex128], dead_s: float
) -> NDArray[np.complex128] | None:
    """Return the poles that least squares finds on signals filtered by 1/denominator."""
    denominator = tuple(np.real(np.poly(poles)).tolist())
    rows, aims = [], []
    for trial in trials[:8]:
        ins = powers(denominator, dead_s, trial.step_s, trial.given, trial.hold, float(trial.given[0]))
        outs = powers(denominator, 0.0, trial.step_s, trial.measured, "linear", float(trial.measured[0]))
        constant = np.ones((len(ins), 1))
        columns = np.column_stack([-outs[:, : shape.poles], ins[:, : shape.zeros + 1], constant])
        rows.append(columns[trial.used])
        aims.append(outs[trial.used, shape.poles])
    table, aim = np.concatenate(rows), np.concatenate(aims)
    sizes = np.linalg.norm(table, axis=0)
    if not np.all(np.isfinite(sizes)) or np.any(sizes[: shape.poles] == 0.0):
        return None
    solved = solve(table, aim, rcond=1e-12)
    roots = np.roots([1.0, *solved[: shape.poles][::-1]])
    if not np.all(np.isfinite(roots)) or np.any(np.abs(roots) == 0.0):
        return None
    return np.asarray(-np.abs(roots.real) + 1j * roots.imag)


def compare_orders(fit: TransferFit, name: str) -> tuple[TextTable, list[str]]:
    """Return the neighbouring orders with error and Akaike's criterion, and a sentence on each that is larger.

    The criterion counts independent samples: those there are over the residual's correlation length. An order can leave
    no more than a smaller one, which it contains; where its fit does, the search has not converged: it is marked so,
    without a criterion.
    """
    shape = fit.shape
    near = ((shape.poles + p, shape.zeros + z) for p, z in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)))
    shapes = [replace(shape, poles=p, zeros=z) for p, z in near if p >= 1 and 0 <= z <= p]
    residuals = fit.residuals()
    count = sum(len(part) for part in residuals)
    effective = count / max(correlation_length(residuals), 1.0)
    squares = {
        other: fit.point.squares
        if other == shape
        else best_fit(other, fit.trials, starts=2, near=_near(fit, other)).squares
        for other in sorted(shapes, key=lambda order: (order.poles, order.zeros))
    }
    missed = unconverged(squares)
    rows, messages = [], []
    for other, left in squares.items():
        rms = float(np.sqrt(left / count))
        aic = effective * float(np.log(max(left, 1e-300) / count)) + 2.0 * other.size
        mark = " (this one)" if other == shape else ""
        last = "did not converge" if other in missed else f"{aic:.1f}"
        rows.append((f"{other.poles}{mark}", str(other.zeros), f"{rms:.4g}", last))
        if other == shape and other in missed:
            messages.append(
                f"{name}: this order left more than a smaller one, which it contains: its fit did not converge; "
                "take the smaller one (poles, zeros)"
            )
        if other.poles + other.zeros > shape.poles + shape.zeros and other not in missed:
            fall = 1.0 - np.sqrt(left / max(fit.point.squares, 1e-300))
            what = "a pole more" if other.poles > shape.poles else "a zero more"
            verdict = "not worth it" if fall < _WORTH else "worth a try"
            messages.append(
                f"{name}: {what} would lower the error by {100 * max(fall, 0.0):.2g} %: {verdict}"
            )
    header = ("poles", "zeros", f"RMS, {fit.transfer.output_unit}", "AIC")
    return TextTable(f"{name}: other orders", header, tuple(rows)), messages


def unconverged(squares: Mapping[Shape, float]) -> set[Shape]:
    """Return the orders that left more, as a sum of squares, than a smaller one that they contain."""
    return {
        name
        for name, left in squares.items()
        for other, less in squares.items()
        if (other.poles, other.zeros) != (name.poles, name.zeros)
        and other.poles <= name.poles
        and other.zeros <= name.zeros
        and left > less * (1.0 + _ROUNDING) ** 2
    }


def _near(fit: TransferFit, other: Shape) -> list[FloatArray]:
    """Return this fit as a point of another order: a pole more is the fastest there is, which changes least."""
    poles = fit.transfer.poles
    if other.poles > fit.shape.poles:
        poles = np.append(poles, -1.0 / _shortest_s(fit.trials))
    elif other.poles < fit.shape.poles:
        return []
    return [other.at(poles, fit.transfer.dead_s)]
