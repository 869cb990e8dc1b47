"""Output error in continuous time: the transfer function whose simulated answer comes nearest to the measured one.

The numerator, the offsets and the initial states enter linearly, so the search moves the denominator and the dead time
only, and the others follow by least squares at every point (variable projection, Golub and Pereyra 1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.fit.transfer.shape import Shape
from labrun.fit.transfer.transfer import Transfer
from labrun.fit.transfer.trials import SAME_DIRECTION, Answers, ResponseTrial, basis, total_s, without

FloatArray = NDArray[np.float64]
_STEP = 1e-5
_MOST_DEAD = 0.3
"""A dead time is looked for up to this share of the longest trial."""
_DECADES_BEYOND = 1.5
"""Time constants are looked for this many decades beyond the sampling step and the longest trial."""


@dataclass(frozen=True, slots=True)
class Point:
    """A candidate with its least-squares partners.

    Attributes
    ----------
    moved, linear
        What the search moves, and what follows from it.
    own : one (k,) a trial
        Offset and initial state.
    residuals : one (n_used,) a trial
        Measured less simulated.
    squares
        Their sum.
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


def transfer_of(shape: Shape, numbers: FloatArray, **names: str) -> Transfer:
    """Return the transfer function that numbers as of `Point.numbers` describe."""
    moved, linear = numbers[: shape.moved], numbers[shape.moved :]
    numerator = tuple(float(one) for one in linear[: shape.zeros + 1][::-1])
    return Transfer(numerator, shape.denominator(moved), shape.dead_s(moved), **names)


def evaluate(shape: Shape, trials: Sequence[ResponseTrial], moved: FloatArray) -> Point:
    """Return a candidate's best numerator, offsets and initial states."""
    answers = Answers(shape, moved)
    shared, outputs, owns, spans = [], [], [], []
    for trial in trials:
        own = answers.own(trial)[trial.used]
        span = basis(own)
        owns.append(own)
        spans.append(span)
        shared.append(without(answers.shared(trial)[trial.used], span))
        outputs.append(without(trial.measured[trial.used], span))
    columns = np.concatenate(shared)
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    linear = np.linalg.lstsq(columns / sizes, np.concatenate(outputs), rcond=1e-12)[0] / sizes
    residuals = tuple(y - x @ linear for x, y in zip(shared, outputs, strict=True))
    mine = []
    for trial, own in zip(trials, owns, strict=True):
        rest = trial.measured[trial.used] - answers.shared(trial)[trial.used] @ linear
        mine.append(_solved(own, rest))
    squares = sum(float(part @ part) for part in residuals)
    return Point(shape, np.array(moved, dtype=float), linear, tuple(mine), residuals, squares)


def _solved(columns: FloatArray, aim: FloatArray) -> FloatArray:
    """Return the least-squares weights of columns, whatever their sizes; see `basis`, which spans the same."""
    if columns.shape[1] == 0:
        return np.zeros(0)
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(columns / sizes, aim, rcond=SAME_DIRECTION)[0] / sizes)


def descend(shape: Shape, trials: Sequence[ResponseTrial], start: FloatArray, evaluations: int = 60) -> Point:
    """Return the minimum that a start leads to."""
    from scipy.optimize import least_squares

    low, high = bounds(shape, trials)
    if shape.moved == 0:
        return evaluate(shape, trials, start)
    first = np.clip(start, low + 1e-9, high - 1e-9)

    def residuals(moved: FloatArray) -> FloatArray:
        return np.concatenate(evaluate(shape, trials, moved).residuals)

    found = least_squares(
        residuals, first, bounds=(low, high), x_scale=_scales(shape, trials), diff_step=None,
        xtol=1e-9, ftol=1e-11, gtol=1e-11, max_nfev=evaluations,
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


def derivatives(point: Point, trials: Sequence[ResponseTrial]) -> list[FloatArray]:
    """Return d(simulated)/d(numbers) of every trial's used samples, offsets and initial states eliminated."""
    shape = point.shape
    moving = []
    for place, scale in enumerate(_scales(shape, trials)):
        ahead, behind = point.moved.copy(), point.moved.copy()
        width = _STEP * scale
        at_bound = shape.dead_time and place == shape.poles and point.moved[place] < width
        ahead[place] += width
        behind[place] -= 0.0 if at_bound else width
        sides = [_answers_of(point, trials, moved) for moved in (ahead, behind)]
        moving.append([(a - b) / (ahead[place] - behind[place]) for a, b in zip(*sides, strict=True)])
    answers = Answers(shape, point.moved)
    found = []
    for index, trial in enumerate(trials):
        columns = np.column_stack(
            [*(one[index][trial.used] for one in moving), answers.shared(trial)[trial.used]]
        )
        found.append(without(columns, basis(answers.own(trial)[trial.used])))
    return found


def _answers_of(point: Point, trials: Sequence[ResponseTrial], moved: FloatArray) -> list[FloatArray]:
    other = Point(point.shape, moved, point.linear, point.own, point.residuals, point.squares)
    return other.simulated(trials)


def _scales(shape: Shape, trials: Sequence[ResponseTrial]) -> FloatArray:
    """Return how far each number of the search moves before the answer looks different."""
    scales = np.ones(shape.moved)
    if shape.dead_time:
        scales[-1] = max(trial.step_s for trial in trials)
    return scales
