"""Gains that follow best under margins that must be kept."""

import math
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError
from labrun.fit.tuning.loop import ComplexArray, Gains, OpenLoop, allowed_gain, horizon_s, margins
from labrun.fit.tuning.settings import PidFitSettings
from labrun.fit.tuning.simc import Structure

_TIME_FACTORS = (0.02, 50.0)
"""Bounds of integral and derivative time, over the loop's own time."""
_LEAST_SHARE = 0.02
_STARTS = ((0.4, 0.8), (1.0, 0.8))
"""Integral time over the loop's time, share of the allowed gain: where the search begins."""
_BACK_OFF = 0.999
_CONTINUOUS_STEPS = 400
"""Steps of a loop without a rate, over the time it is looked at."""
_MOST_STEPS = 1 << 15


def optimum(
    loop: OpenLoop,
    structure: Structure,
    wanted: PidFitSettings,
    *,
    feedforward: float | None = None,
    lead_s: float = 0.0,
    gain_error: float = 0.0,
) -> Gains:
    """Return the gains of least error under the margins that must be kept.

    Every candidate keeps the margins: integral and derivative time give the curve its shape, the margins then bound its
    gain in closed form (`allowed_gain`), and what is searched for is the share of that. The error comes from the exact
    frequency response on the odd harmonics of a square wave whose half period is long against the loop: a step that
    has settled before the next one.

    Parameters
    ----------
    loop
        Around a stable plant.
    wanted
        Margins, criterion, weight of the load and filter of the derivative.
    feedforward, lead_s
        As of `Gains`: the feedback then has to mend what the feed-forward leaves.
    gain_error
        Relative error of the plant's gain: the mean over plants with it, without it and with its opposite is minimised,
        and the margins are kept by the one with the largest gain.

    Raises
    ------
    FitError
        The plant is not stable, or has no static gain.
    """
    from scipy.optimize import minimize

    require_stable(loop)
    error = _Error(loop, wanted, feedforward, lead_s, gain_error)
    size = {"P": 1, "PI": 2, "PID": 3}[structure]
    times = [(math.log(low), math.log(high)) for low, high in [_TIME_FACTORS] * 2]
    bounds = [(_LEAST_SHARE, 1.0), *times][:size]
    best: tuple[float, FloatArray] | None = None
    for integral, share in _STARTS[: 1 if structure == "P" else None]:
        start = np.array([share, math.log(integral), math.log(0.15)][:size])
        solution = minimize(  # type: ignore[call-overload]
            lambda x: error(error.gains(x)),
            start,
            method="Nelder-Mead",
            bounds=bounds,
            options={"xatol": 1e-3, "fatol": 1e-5, "maxfev": 120 * size, "initial_simplex": _simplex(start)},
        )
        if best is None or solution.fun < best[0]:
            best = (float(solution.fun), np.asarray(solution.x))
    assert best is not None  # noqa: S101  (there is a start)
    return kept(error.gains(best[1]), loop, wanted, 1.0 + gain_error)


def loop_error(loop: OpenLoop, gains: Gains, wanted: PidFitSettings) -> float:
    """Return the error that `optimum` minimises, relative to the loop's own time; the loop must be stable."""
    return _Error(loop, wanted, gains.feedforward, gains.lead_s, gain_error=0.0)(gains)


def kept(gains: Gains, loop: OpenLoop, wanted: PidFitSettings, factor: float = 1.0) -> Gains:
    """Return gains made smaller until the margins are kept, between the points of the grid too.

    `factor`: the margins are those of a plant whose gain is so many times larger.
    """
    for _ in range(200):
        if keeps(gains.scaled(factor), loop, wanted):
            return gains
        gains = gains.scaled(_BACK_OFF)
    raise FitError(
        "no gain keeps the requested margins",
        hint="ask for a smaller gain_margin or phase_margin_deg",
    )


def keeps(gains: Gains, loop: OpenLoop, wanted: PidFitSettings) -> bool:
    """Tell whether a loop is stable with the margins that were asked for."""
    loop_margins = margins(gains, loop)
    return (
        loop_margins.stable
        and loop_margins.gain >= wanted.gain_margin
        and loop_margins.phase_deg >= wanted.phase_margin_deg
        and (wanted.max_sensitivity is None or loop_margins.sensitivity <= wanted.max_sensitivity)
    )


def require_stable(loop: OpenLoop) -> None:
    """Raise FitError if the plant is one that no margin on its curve alone can judge."""
    poles = np.atleast_1d(np.asarray(loop.plant.poles))
    if np.any(poles.real >= 0):
        raise FitError(
            "controllers are designed for plants that settle, and this one has a pole in the right half plane or at 0",
            hint="record longer after the step, or fit fewer poles",
        )
    if not (np.isfinite(loop.gain) and loop.gain != 0):
        raise FitError(
            "the fitted response has no static gain: nothing can hold its output",
            hint="look at the fit's figure: does the output stay where the step brings it?",
        )


def _simplex(start: FloatArray) -> FloatArray:
    corners = [start]
    for index in range(len(start)):
        moved = start.copy()
        moved[index] += -0.25 if index == 0 else 0.4
        corners.append(moved)
    return np.array(corners)


class _Error:
    """Error of a loop by its frequency response; everything that does not depend on the gains is computed once."""

    def __init__(
        self,
        loop: OpenLoop,
        wanted: PidFitSettings,
        feedforward: float | None,
        lead_s: float,
        gain_error: float,
    ) -> None:
        self._loop, self._wanted = loop, wanted
        self._feedforward, self._lead_s = feedforward, lead_s
        self._factors = (1.0 - gain_error, 1.0, 1.0 + gain_error) if gain_error else (1.0,)
        self._time_s = loop.delay_s + float(np.sum(loop.lags_s))
        half_s = horizon_s(loop)
        self._step_s = step_s = loop.step_s or half_s / _CONTINUOUS_STEPS
        self._steps = steps = int(min(max(half_s / step_s, 64), _MOST_STEPS))
        self._harmonics = np.arange(1, steps + 1, 2)  # up to the Nyquist frequency
        self._omega: FloatArray = np.asarray(np.pi * self._harmonics / (steps * step_s), dtype=float)
        self._feedback = loop.frequency_response(self._omega)
        # what counts is the output itself, not its average
        self._output = replace(loop, average_s=0.0).frequency_response(self._omega)
        square = np.ones(2 * steps)
        square[steps:] = -1.0
        # a step of 2 from plateau to plateau: halved, it is a unit step
        self._reference = np.fft.rfft(0.5 * square)[self._harmonics]
        self._late_s = np.arange(steps) * step_s

    def gains(self, point: FloatArray) -> Gains:
        """Return the gains at a point: share of the allowed gain, log of integral and derivative time."""
        loop, wanted = self._loop, self._wanted
        i = 1.0 / (self._time_s * math.exp(point[1])) if len(point) > 1 else 0.0
        d = self._time_s * math.exp(point[2]) if len(point) > 2 else 0.0
        shape = Gains(1.0, i, d, d / wanted.derivative_filter, self._feedforward, self._lead_s)
        sign = math.copysign(1.0, loop.gain)
        curve = sign * shape.frequency_response(loop.grid_rad_s, loop.step_s) * loop.grid_response
        most = allowed_gain(curve, wanted.gain_margin, wanted.phase_margin_deg, wanted.max_sensitivity)
        # a plant without dead time and of low order allows any gain: a thousandfold is enough of it
        most = min(most / self._factors[-1], 1e3 / abs(loop.gain))
        return shape.scaled(sign * float(point[0]) * most)

    def __call__(self, gains: Gains) -> float:
        """Return the error of steps of reference and load, relative to the loop's own time."""
        return sum(self._error(gains, factor) for factor in self._factors) / len(self._factors)

    def _error(self, gains: Gains, factor: float) -> float:
        through = gains.frequency_response(self._omega, self._loop.step_s)
        closed = 1.0 + through * factor * self._feedback
        towards = self._towards(gains, through)
        followed = 1.0 - factor * self._output * towards / closed
        loaded = factor * self._output / closed / (factor * self._loop.gain)
        total = self._size(followed * self._reference)
        if self._wanted.load_weight:
            total += self._wanted.load_weight * self._size(loaded * self._reference)
        return total

    def _towards(self, gains: Gains, through: ComplexArray) -> ComplexArray:
        """Return drive over reference with the feedback cut: the derivative sees the measurement only."""
        own = Gains(gains.p, gains.i_per_s)
        towards = own.frequency_response(self._omega, self._loop.step_s) if gains.d_s else through
        if gains.feedforward is None:
            return towards
        return np.asarray(towards + gains.feedforward * np.exp(1j * self._omega * gains.lead_s))

    def _size(self, spectrum: ComplexArray) -> float:
        whole = np.zeros(self._steps + 1, dtype=complex)
        whole[self._harmonics] = spectrum
        error = np.abs(np.fft.irfft(whole, 2 * self._steps)[: self._steps])
        if self._wanted.criterion == "itae":
            return float(error @ self._late_s) * self._step_s / self._time_s**2
        return float(np.sum(error)) * self._step_s / self._time_s
