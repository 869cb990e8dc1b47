"""A transfer function fitted to trials, with intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.fit.estimate import Estimate
from labrun.fit.resampling import resample_trials
from labrun.fit.transfer.estimation import Point, derivatives, transfer_of
from labrun.fit.transfer.shape import Shape
from labrun.fit.transfer.starts import STARTS, best_fit
from labrun.fit.transfer.transfer import Transfer
from labrun.fit.transfer.trials import ResponseTrial

FloatArray = NDArray[np.float64]
_BLOCKS = 10
_FARTHEST = 20.0
"""Draws of a logarithm are cut here: beyond it nothing is determined."""


@dataclass(frozen=True, slots=True)
class TransferFit:
    """A fitted transfer function.

    Attributes
    ----------
    point
        Its numbers, and what is left.
    transfer
        It.
    draws : (b, size)
        Resampled numbers.
    blocks
        How many parts were resampled in place of trials; 0 if trials were.
    """

    shape: Shape
    trials: tuple[ResponseTrial, ...]
    point: Point
    transfer: Transfer
    draws: FloatArray
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

    def resampled(self) -> tuple[Transfer, ...]:
        """Return the transfer functions of the resampled numbers."""
        return tuple(transfer_of(self.shape, numbers) for numbers in self.draws)

    def estimate(self, quantity: Callable[[Transfer], float], unit: str) -> Estimate:
        """Return any quantity of the transfer function with its 95 % interval."""
        values = [quantity(transfer_of(self.shape, numbers)) for numbers in self.draws]
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
        Names and units, as of `Transfer`.

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
        pairs = zip(
            np.array_split(columns[0], blocks), np.array_split(point.residuals[0], blocks), strict=True
        )
        parts = list(pairs)
    information = np.array([j.T @ j for j, _ in parts])
    score = np.array([j.T @ r for j, r in parts])
    drawn = resample_trials(information, score, rng=rng, resamples=1000).draws
    draws = point.numbers + np.clip(drawn, -_scale(shape, point), _scale(shape, point))
    return TransferFit(shape, tuple(trials), point, transfer_of(shape, point.numbers, **names), draws, blocks)


def fit_fopdt(
    trials: Sequence[ResponseTrial], *, rng: np.random.Generator, starts: int = STARTS, **names: str
) -> TransferFit:
    """Fit ``gain exp(-dead_s s)/(lag_s s + 1)``; every trial has an offset of its own and starts steady."""
    return fit_transfer(trials, Shape(1, 0), rng=rng, starts=starts, **names)


def _scale(shape: Shape, point: Point) -> FloatArray:
    limits = np.full(len(point.numbers), np.inf)
    limits[: shape.poles] = _FARTHEST
    return limits
