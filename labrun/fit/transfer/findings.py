"""What a fitted transfer function leaves unexplained, and what its data cannot tell."""

import numpy as np
from numpy.typing import NDArray

from labrun.fit.correlation import correlation_length
from labrun.fit.estimate import rounded
from labrun.fit.transfer.fitting import TransferFit

FloatArray = NDArray[np.float64]
_CLOSE = 0.1
_LOOSE = 3.0
"""A lag whose interval spans more than this factor is not known by itself."""
_LAGS = 100


def leftovers(fit: TransferFit, name: str, unit: str) -> list[str]:
    """Return in words how large the residual is, whether it is white, and whether it still follows the input."""
    residuals = fit.residuals()
    spread = np.sqrt(np.mean(np.concatenate([_centred(t.measured[t.used]) for t in fit.trials]) ** 2))
    share = 100.0 * fit.rmse / spread if spread > 0 else 0.0
    step_s = fit.trials[0].step_s
    length = correlation_length(residuals)
    white = (
        "neighbouring samples of it are unrelated (white)"
        if length < 3.0
        else f"it stays correlated for {length * step_s:.2g} s: slow disturbance or dynamics that the model lacks"
    )
    found = [
        f"{name}: what is left is {fit.rmse:.3g} {unit} RMS, {share:.2g} % of the output's variation; {white}"
    ]
    strongest, limit = _input_correlation(fit, residuals, length)
    if strongest > limit:
        found.append(
            f"{name}: the residual still follows the input (correlation {strongest:.2f}, chance gives {limit:.2f}): "
            "more poles or zeros, or a nonlinearity, would explain more"
        )
    else:
        found.append(
            f"{name}: the residual does not follow the input (correlation {strongest:.2f}, chance {limit:.2f})"
        )
    return found


def warnings_of(fit: TransferFit, name: str) -> list[str]:
    """Return what to know before trusting the numbers."""
    said = []
    if fit.blocks:
        said.append(
            f"{name}: one trial: intervals rest on {fit.blocks} parts of it, not on independent repeats"
        )
    elif len(fit.trials) < 4:
        said.append(
            f"{name}: only {len(fit.trials)} trials: the intervals rest on their differences, and are wide"
        )
    step_s = fit.trials[0].step_s
    if fit.shape.dead_time and fit.transfer.dead_s < step_s:
        said.append(
            f"{name}: the dead time is below a sample ({step_s:.2g} s): it cannot be told from none at this rate"
        )
    for pole in fit.transfer.poles:
        slow_s = 1.0 / max(abs(pole), 1e-300)
        if slow_s < step_s:
            said.append(
                f"{name}: a time constant of {slow_s:.2g} s is below a sample ({step_s:.2g} s): not determined, and "
                "the intervals of the coefficients hold for this one only; fit a pole less"
            )
        said += [
            f"{name}: a pole and a zero nearly cancel at {abs(pole):.3g} rad/s: one of each fewer fits as well"
            for zero in fit.transfer.zeros
            if abs(pole - zero) < _CLOSE * abs(pole)
        ]
    spread = np.std(fit.draws, axis=0)
    if np.any(spread[: fit.shape.poles] > 1.0):
        said.append(
            f"{name}: the data do not determine {fit.shape.poles} poles: a coefficient of the denominator varies by "
            "more than its value between resamples; record a faster input, more trials, or fit fewer poles"
            if fit.shape.poles > 1
            else f"{name}: the data do not determine the lag: it varies by more than its value between resamples; "
            "record a faster input, or more trials"
        )
    return said + _told_apart(fit, name)


def _told_apart(fit: TransferFit, name: str) -> list[str]:
    """Return a warning where the data know the sum of lag and dead time much better than either."""
    if not (fit.transfer.is_first_order and fit.shape.dead_time and len(fit.draws)):
        return []
    lag = fit.estimate(lambda transfer: transfer.lag_s, "s")
    dead = fit.estimate(lambda transfer: transfer.dead_s, "s")
    if dead.ci95[0] > fit.trials[0].step_s and lag.ci95[1] < _LOOSE * lag.ci95[0]:
        return []
    value, low, high = rounded(fit.estimate(lambda transfer: transfer.lag_s + transfer.dead_s, "s"))
    return [
        f"{name}: the data hardly tell lag from dead time; their sum is {value} s ({low} ... {high}); a faster step, "
        "less averaging or more trials would tell them apart"
    ]


def _centred(values: FloatArray) -> FloatArray:
    return values - np.mean(values)


def _input_correlation(fit: TransferFit, residuals: list[FloatArray], length: float) -> tuple[float, float]:
    """Return the largest correlation of residual and earlier input, and what chance gives in 1 of 20 fits."""
    total = np.zeros(_LAGS)
    inputs = outputs = 0.0
    count = 0
    for trial, residual in zip(fit.trials, residuals, strict=True):
        given = _centred(trial.given[trial.used])
        rest = _centred(residual)
        lags = min(_LAGS, len(rest) // 2)
        for lag in range(lags):
            total[lag] += rest[lag:] @ given[: len(given) - lag]
        inputs += float(given @ given)
        outputs += float(rest @ rest)
        count += len(rest)
    if inputs == 0.0 or outputs == 0.0:
        return 0.0, 0.0
    largest = float(np.max(np.abs(total)) / np.sqrt(inputs * outputs))
    return largest, float(min(3.5 * np.sqrt(max(length, 1.0) / count), 1.0))
