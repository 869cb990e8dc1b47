"""Output error in continuous time: the transfer function whose simulated answer comes nearest to the measured one.

The denominator is a product of sections ``a2 s^2 + a1 s + 1`` (and one ``a1 s + 1`` if the order is odd) whose
coefficients are powers of e: every point of the search is stable, and every stable denominator is one of its points.
The numerator, the offsets and the initial states enter linearly, so the search moves the denominator and the dead time
only, and the others follow by least squares at every point (variable projection, Golub and Pereyra 1973).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.fit.regression.least_squares import solve
from labrun.fit.signals import trailing_mean
from labrun.fit.transfer.response import Hold, free_answers, powers
from labrun.fit.transfer.transfer_function import TransferFunction

Initial = Literal["steady", "free"]
_SAME_DIRECTION = 1e-6
"""What adds less than this share of the largest direction is rounding: the free answers of poles far apart."""
_STEP = 1e-5
_MOST_DEAD = 0.3
"""A dead time is looked for up to this share of the longest trial."""
_DECADES_BEYOND = 1.5
"""Time constants are looked for this many decades beyond the sampling step and the longest trial."""


@dataclass(frozen=True, slots=True)
class Shape:
    """What is looked for.

    Attributes
    ----------
    dead_time
        Whether there is one.
    initial
        What each trial starts from: the steady state of its first input, or anything.
    """

    poles: int
    zeros: int
    dead_time: bool = True
    initial: Initial = "steady"

    @property
    def moved(self) -> int:
        """How many numbers the search moves: the denominator's, and the dead time."""
        return self.poles + int(self.dead_time)

    @property
    def linear(self) -> int:
        """How many follow from those by linear least squares: the numerator's."""
        return self.zeros + 1

    @property
    def size(self) -> int:
        """How many numbers describe it."""
        return self.moved + self.linear

    def denominator(self, moved: FloatArray) -> tuple[float, ...]:
        """Return the denominator, its last coefficient 1."""
        product = np.ones(1)
        for place in range(0, self.poles - 1, 2):
            product = np.polymul(product, [np.exp(moved[place]), np.exp(moved[place + 1]), 1.0])
        if self.poles % 2:
            product = np.polymul(product, [np.exp(moved[self.poles - 1]), 1.0])
        return tuple(float(one) for one in product)

    def dead_s(self, moved: FloatArray) -> float:
        """Return the dead time, s."""
        return max(float(moved[self.poles]), 0.0) if self.dead_time else 0.0

    def at(self, poles: NDArray[np.complex128], dead_s: float) -> FloatArray:
        """Return the point of a set of poles, unstable ones mirrored to the left, and of a dead time."""
        left = -np.abs(poles.real) + 1j * poles.imag
        left = np.where(left.real == 0.0, left - 1e-3 * np.abs(left) - 1e-9, left)
        pairs = sorted(left[left.imag > 1e-12], key=abs)
        single = sorted(left[np.abs(left.imag) <= 1e-12].real, key=abs)
        sections = [(abs(one) ** 2, -2.0 * one.real) for one in pairs]
        while len(single) > 1:
            one, other = single.pop(0), single.pop(0)
            sections.append((one * other, -one - other))
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
            return _averaged(columns[:, : self.shape.zeros + 1], trial.averaged)

        return self._once(make, "shared", id(trial.given), trial.averaged)

    def own(self, trial: ResponseTrial) -> FloatArray:
        """Return what each trial's own numbers weigh: its offset and its initial state, (n, own)."""

        def make() -> FloatArray:
            columns = np.ones((len(trial.time_s), 1))
            if self.shape.initial == "steady":
                return columns
            free = free_answers(self.shape.denominator(self.moved), trial.step_s, len(trial.time_s))
            return np.column_stack([columns, _averaged(free, trial.averaged)])

        return self._once(make, "own", len(trial.time_s), trial.averaged)

    def span(self, trial: ResponseTrial) -> FloatArray:
        """Return an orthonormal basis of `own` at the samples used, (n_used, k)."""
        key = (len(trial.time_s), trial.averaged, trial.used.tobytes())
        return self._once(lambda: basis(self.own(trial)[trial.used]), "span", *key)

    def projected(self, trial: ResponseTrial) -> FloatArray:
        """Return `shared` at the samples used, less its part in `own`, (n_used, linear)."""
        key = (id(trial.given), trial.averaged, trial.used.tobytes())
        return self._once(
            lambda: without(self.shared(trial)[trial.used], self.span(trial)), "projected", *key
        )


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


def _averaged(columns: FloatArray, samples: int) -> FloatArray:
    if samples <= 1:
        return columns
    return np.column_stack([trailing_mean(column, samples) for column in columns.T])


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
    numerator = tuple(float(one) for one in linear[: shape.zeros + 1][::-1])
    return TransferFunction(numerator, shape.denominator(moved), shape.dead_s(moved), **names)


def evaluate(shape: Shape, trials: Sequence[ResponseTrial], moved: FloatArray) -> CandidatePoint:
    """Return a candidate's best numerator, offsets and initial states."""
    answers = Answers(shape, moved)
    linear, residuals = _projected(answers, trials)
    own = []
    for trial in trials:
        rest = trial.measured[trial.used] - answers.shared(trial)[trial.used] @ linear
        own.append(solve(answers.own(trial)[trial.used], rest, rcond=_SAME_DIRECTION))
    squares = sum(float(part @ part) for part in residuals)
    return CandidatePoint(shape, np.array(moved, dtype=float), linear, tuple(own), tuple(residuals), squares)


def residuals_of(shape: Shape, trials: Sequence[ResponseTrial], moved: FloatArray) -> FloatArray:
    """Return what the best numerator, offsets and initial states leave of all trials."""
    return np.concatenate(_projected(Answers(shape, moved), trials)[1])


def _projected(answers: Answers, trials: Sequence[ResponseTrial]) -> tuple[FloatArray, list[FloatArray]]:
    """Return the best numerator and every trial's residual, offsets and initial states projected out."""
    shared = [answers.projected(trial) for trial in trials]
    outputs = [without(trial.measured[trial.used], answers.span(trial)) for trial in trials]
    linear = solve(np.concatenate(shared), np.concatenate(outputs), rcond=1e-12)
    return linear, [y - x @ linear for x, y in zip(shared, outputs, strict=True)]


def descend(
    shape: Shape, trials: Sequence[ResponseTrial], start: FloatArray, evaluations: int = 60
) -> CandidatePoint:
    """Return the minimum that a start leads to."""
    from scipy.optimize import least_squares

    low, high = bounds(shape, trials)
    if shape.moved == 0:
        return evaluate(shape, trials, start)
    first = np.clip(start, low + 1e-9, high - 1e-9)

    def residuals(moved: FloatArray) -> FloatArray:
        return residuals_of(shape, trials, moved)

    found = least_squares(
        residuals, first, bounds=(low, high), x_scale=_scales(shape, trials), xtol=1e-9, ftol=1e-11, gtol=1e-11,
        max_nfev=evaluations,
    )  # fmt: skip
    end = evaluate(shape, trials, found.x)
    began = evaluate(shape, trials, first)
    return end if end.squares <= began.squares else began


def bounds(shape: Shape, trials: Sequence[ResponseTrial]) -> tuple[FloatArray, FloatArray]:
    """Return the box that is searched."""
    low_s = shortest_s(trials)
    high_s = total_s(trials) * 10.0**_DECADES_BEYOND
    low, high = np.full(shape.moved, np.log(low_s)), np.full(shape.moved, np.log(high_s))
    for place in range(0, shape.poles - 1, 2):
        low[place], high[place] = 2.0 * np.log(low_s), 2.0 * np.log(high_s)
        # a section may be damped by next to nothing
        low[place + 1] -= 3.0 * np.log(10.0)
    if shape.dead_time:
        low[-1], high[-1] = 0.0, _MOST_DEAD * total_s(trials)
    return low, high


def shortest_s(trials: Sequence[ResponseTrial]) -> float:
    """Return the shortest time constant that is looked for."""
    return float(min(trial.step_s for trial in trials) * 10.0**-_DECADES_BEYOND)


def derivatives(point: CandidatePoint, trials: Sequence[ResponseTrial]) -> list[FloatArray]:
    """Return d(simulated)/d(numbers) of every trial's used samples, offsets and initial states eliminated."""
    shape = point.shape
    moving = []
    for place, scale in enumerate(_scales(shape, trials)):
        ahead, behind = point.moved.copy(), point.moved.copy()
        width = _STEP * scale
        at_bound = shape.dead_time and place == shape.poles and point.moved[place] < width
        ahead[place] += width
        behind[place] -= 0.0 if at_bound else width
        sides = [replace(point, moved=moved).simulated(trials) for moved in (ahead, behind)]
        moving.append([(a - b) / (ahead[place] - behind[place]) for a, b in zip(*sides, strict=True)])
    answers = Answers(shape, point.moved)
    found = []
    for index, trial in enumerate(trials):
        columns = np.column_stack(
            [*(one[index][trial.used] for one in moving), answers.shared(trial)[trial.used]]
        )
        found.append(without(columns, answers.span(trial)))
    return found


def _scales(shape: Shape, trials: Sequence[ResponseTrial]) -> FloatArray:
    """Return how far each number of the search moves before the answer looks different."""
    scales = np.ones(shape.moved)
    if shape.dead_time:
        scales[-1] = max(trial.step_s for trial in trials)
    return scales
