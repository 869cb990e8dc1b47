"""A transfer function fitted to trials: where the search starts, its best minimum, intervals, and other orders."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import FitError
from labrun.estimate import Estimate
from labrun.fit.regression.least_squares import solve
from labrun.fit.resampling import correlation_length, resample_trials
from labrun.fit.result import TextTable
from labrun.fit.transfer.estimation import (
    CandidatePoint,
    ResponseTrial,
    Shape,
    bounds,
    derivatives,
    descend,
    residuals_of,
    shortest_s,
    total_s,
    transfer_of,
)
from labrun.fit.transfer.response import powers
from labrun.fit.transfer.transfer_function import TransferFunction

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

    def estimate(self, quantity: Callable[[TransferFunction], float], unit: str) -> Estimate:
        """Return any quantity of the transfer function with its 95 % interval."""
        values = [quantity(one) for one in self.resampled]
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
    """Fit a transfer function of a given shape to trials.

    Parameters
    ----------
    trials
        Each evenly spaced; steps may differ.
    rng
        Of the resamples.
    names
        Names and units, as of `TransferFunction`.

    Raises
    ------
    FitError
        Nothing moves, or too few samples.
    """
    point = best_fit(shape, trials, starts=starts)
    columns = derivatives(point, trials)
    parts = list(zip(columns, point.residuals, strict=True))
    blocks = 0
    if len(parts) == 1:
        blocks = _BLOCKS
        split = (np.array_split(whole, blocks) for whole in parts[0])
        parts = list(zip(*split, strict=True))
    information = np.array([j.T @ j for j, _ in parts])
    score = np.array([j.T @ r for j, r in parts])
    drawn = resample_trials(information, score, rng=rng, resamples=1000).draws
    farthest = np.where(np.arange(shape.size) < shape.poles, _FARTHEST, np.inf)
    draws = point.numbers + np.clip(drawn, -farthest, farthest)
    return TransferFit(
        shape,
        tuple(trials),
        point,
        transfer_of(shape, point.numbers, **names),
        draws,
        tuple(transfer_of(shape, numbers) for numbers in draws),
        blocks,
    )


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
    rated.sort(key=lambda one: one[:2])
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
    found = []
    for lag_s in np.geomspace(min(2.0 * step_s, slowest), slowest, _SPEEDS):
        for dead_s in (share * lag_s for share in (_DEADS if shape.dead_time else (0.0,))):
            poles = np.full(shape.poles, -1.0 / lag_s, dtype=complex)
            found.append(shape.at(poles, dead_s))
            for _ in range(_REFINED if shape.poles > 1 else 0):
                refined = _filtered_least_squares(shape, trials, poles, dead_s)
                if refined is None:
                    break
                poles = refined
                found.append(shape.at(poles, dead_s))
    return found


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
    shapes = [shape]
    for poles, zeros in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        p, z = shape.poles + poles, shape.zeros + zeros
        if p >= 1 and 0 <= z <= p:
            shapes.append(Shape(p, z, shape.dead_time, initial=shape.initial))
    residuals = fit.residuals()
    count = sum(len(part) for part in residuals)
    effective = count / max(correlation_length(residuals), 1.0)
    squares = {
        other: fit.point.squares
        if other is shape
        else best_fit(other, fit.trials, starts=2, near=_near(fit, other)).squares
        for other in sorted(shapes, key=lambda one: (one.poles, one.zeros))
    }
    missed = unconverged(squares)
    rows, said = [], []
    for other, left in squares.items():
        rms = float(np.sqrt(left / count))
        aic = effective * float(np.log(max(left, 1e-300) / count)) + 2.0 * other.size
        mark = " (this one)" if other is shape else ""
        last = "did not converge" if other in missed else f"{aic:.1f}"
        rows.append((f"{other.poles}{mark}", str(other.zeros), f"{rms:.4g}", last))
        if other is shape and other in missed:
            said.append(
                f"{name}: this order left more than a smaller one, which it contains: its fit did not converge; "
                "take the smaller one (poles, zeros)"
            )
        if other.poles + other.zeros > shape.poles + shape.zeros and other not in missed:
            fall = 1.0 - np.sqrt(left / max(fit.point.squares, 1e-300))
            what = "a pole more" if other.poles > shape.poles else "a zero more"
            verdict = "not worth it" if fall < _WORTH else "worth a try"
            said.append(f"{name}: {what} would lower the error by {100 * max(fall, 0.0):.2g} %: {verdict}")
    header = ("poles", "zeros", f"RMS, {fit.transfer.output_unit}", "AIC")
    return TextTable(f"{name}: other orders", header, tuple(rows)), said


def unconverged(squares: Mapping[Shape, float]) -> set[Shape]:
    """Return the orders that left more, as a sum of squares, than a smaller one that they contain."""
    return {
        one
        for one, left in squares.items()
        for other, less in squares.items()
        if (other.poles, other.zeros) != (one.poles, one.zeros)
        and other.poles <= one.poles
        and other.zeros <= one.zeros
        and left > less * (1.0 + _ROUNDING) ** 2
    }


def _near(fit: TransferFit, other: Shape) -> list[FloatArray]:
    """Return this fit as a point of another order: a pole more is the fastest there is, which changes least."""
    poles = fit.transfer.poles
    if other.poles > fit.shape.poles:
        poles = np.append(poles, -1.0 / shortest_s(fit.trials))
    elif other.poles < fit.shape.poles:
        return []
    return [other.at(poles, fit.transfer.dead_s)]
