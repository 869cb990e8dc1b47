"""Gains: by Skogestad's rules (SIMC), and those that follow best under margins that must be kept."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError
from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.loop import ComplexArray, Gains, OpenLoop, allowed_gain, horizon_s, margins
from labrun.fit.tuning.settings import PidFitSettings

Structure = Literal["P", "PI", "PID"]
_REAL = 1e-3
"""Imaginary part, relative to the root, below which it counts as real: equal lags split so far by rounding."""
_CLOSE = 1.59
"""A zero cancels a smaller lag rather than the next larger one if their ratio is less: 1.6 in the source, exclusive."""


@dataclass(frozen=True, slots=True)
class Reduced:
    """``gain exp(-dead_s s) / ((lag_s s + 1) (second_lag_s s + 1))``."""

    gain: float
    lag_s: float
    second_lag_s: float
    dead_s: float


def reduce_order(plant: TransferFunction, order: int, extra_delay_s: float = 0.0) -> Reduced:
    """Return a plant of first or second order in place of one of any order.

    The largest lag that is left out is halved between the dead time and the smallest lag that is kept; smaller ones and
    zeros in the right half plane are dead time; zeros in the left half plane cancel a lag by rules T1 to T3. Skogestad,
    Simple analytic rules for model reduction and PID controller tuning, J. Process Control 13 (2003) 291-309.

    Parameters
    ----------
    plant
        With real poles.
    order
        1 or 2.
    extra_delay_s
        Of the loop around it: half a sample, computation, half of an average.

    Raises
    ------
    FitError
        Complex or unstable poles, to which the rule does not apply.
    """
    poles = np.atleast_1d(np.asarray(plant.poles, dtype=complex))
    zeros = np.roots(np.trim_zeros(np.asarray(plant.numerator, dtype=float), "f"))
    for roots, what in ((poles, "poles"), (zeros, "zeros")):
        if np.any(np.abs(roots.imag) > _REAL * np.abs(roots)):
            raise FitError(
                f"the half rule knows real lags only, and the plant has complex {what}",
                hint='use method = "optimum", or fit a first-order response: --model fopdt',
            )
    if np.any(poles.real >= 0):
        raise FitError(
            "the half rule needs a stable plant, and this one has a pole in the right half plane or at 0",
            hint="record longer after the step, until the response has settled",
        )
    lags = sorted((float(-1.0 / pole.real) for pole in poles), reverse=True)
    backward = [float(1.0 / zero.real) for zero in zeros if zero.real > 0]
    forward = sorted((float(-1.0 / zero.real) for zero in zeros if zero.real < 0), reverse=True)
    dead_s = float(plant.dead_s) + extra_delay_s + sum(backward)
    gain = float(plant.gain)
    for lead_s in forward:
        factor, lags = _cancelled(lead_s, lags, _effective_delay_s(lags, order, dead_s))
        gain *= factor
    kept, rest = lags[:order], lags[order:]
    if rest:
        kept[-1] += 0.5 * rest[0]
    kept += [0.0] * (2 - len(kept))
    return Reduced(gain, kept[0], kept[1], _effective_delay_s(lags, order, dead_s))


def _effective_delay_s(lags: list[float], order: int, dead_s: float) -> float:
    rest = lags[order:]
    return dead_s + (0.5 * rest[0] + sum(rest[1:]) if rest else 0.0)


def _cancelled(lead_s: float, lags: list[float], delay_s: float) -> tuple[float, list[float]]:
    """Return the factor and the lags that are left of ``(lead_s s + 1)`` over the lag nearest to it."""
    if not lags:
        return 1.0, lags
    above = [lag for lag in lags if lag >= lead_s]
    below = [lag for lag in lags if lag < lead_s]
    # the nearest larger lag, unless a smaller one is much nearer
    lag = min(above) if above else below[0]
    if above and below and lead_s / below[0] < min(above) / lead_s and lead_s / below[0] < _CLOSE:
        lag = below[0]
    left = list(lags)
    left.remove(lag)
    if lead_s >= lag:
        if lag >= delay_s:
            return lead_s / lag, left  # T1
        return (lead_s / delay_s if lead_s >= delay_s else 1.0), left  # T1a, T1b
    if lead_s >= 5.0 * delay_s:
        return lead_s / lag, left  # T2
    shorter = min(lag, 5.0 * delay_s)  # T3
    return shorter / lag, sorted([*left, shorter - lead_s] if shorter > lead_s else left, reverse=True)


def simc(
    loop: OpenLoop, structure: Structure, *, tau_c_s: float | None = None, derivative_filter: float = 10.0
) -> Gains:
    """Return the gains for a loop, whose sampling, computation and averaging count as dead time.

    Parameters
    ----------
    loop
        Around a stable plant with real poles.
    structure
        P takes the gain of PI and leaves out the integral.
    tau_c_s
        Time constant that the closed loop should have; the effective dead time, if None.
    derivative_filter
        N: the derivative's filter has the time constant Td/N.

    Raises
    ------
    FitError
        The plant has complex or unstable poles.
    """
    extra_s = loop.delay_s - float(loop.plant.dead_s)
    reduced = reduce_order(loop.plant, 2 if structure == "PID" else 1, extra_s)
    return rules(reduced, structure, tau_c_s=tau_c_s, derivative_filter=derivative_filter)


def rules(
    reduced: Reduced, structure: Structure, *, tau_c_s: float | None = None, derivative_filter: float = 10.0
) -> Gains:
    """Return the gains for a reduced plant.

    ``Kc = lag / (gain (tau_c + dead))``, ``Ti = min(lag, 4 (tau_c + dead))``, ``Td = second lag`` in the series form
    ``Kc (1 + 1/(Ti s)) (1 + Td s)``, given here in parallel form: Skogestad, J. Process Control 13 (2003) 291-309,
    (23)-(25). A plant of one lag gets ``Td = dead/3``, the improved rule of Grimholt and Skogestad, J. Process Control
    70 (2018) 36-46. A plant without a lag gets a pure integral.
    """
    tau_c_s = reduced.dead_s if tau_c_s is None else tau_c_s
    closed_s = tau_c_s + reduced.dead_s
    integral_s = min(reduced.lag_s, 4.0 * closed_s)
    # lag over integral time; where both are zero, the rule's limit
    ratio = reduced.lag_s / integral_s if integral_s > 0 else 1.0
    series = reduced.lag_s / (reduced.gain * closed_s)
    per_s = ratio / (reduced.gain * closed_s)
    if structure == "P":
        return Gains(series if reduced.lag_s > 0 else 0.5 / reduced.gain)
    if structure == "PI":
        return Gains(series, per_s)
    derivative_s = reduced.second_lag_s or reduced.dead_s / 3.0
    p, d = series + per_s * derivative_s, series * derivative_s
    return Gains(p, per_s, d, d / p / derivative_filter if p else 0.0)


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
        found = minimize(  # type: ignore[call-overload]
            lambda x: error(error.gains(x)),
            start,
            method="Nelder-Mead",
            bounds=bounds,
            options={"xatol": 1e-3, "fatol": 1e-5, "maxfev": 120 * size, "initial_simplex": _simplex(start)},
        )
        if best is None or found.fun < best[0]:
            best = (float(found.fun), np.asarray(found.x))
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
        "no gain was found that keeps the margins that were asked for",
        hint="ask for a smaller gain_margin or phase_margin_deg",
    )


def keeps(gains: Gains, loop: OpenLoop, wanted: PidFitSettings) -> bool:
    """Tell whether a loop is stable with the margins that were asked for."""
    found = margins(gains, loop)
    return (
        found.stable
        and found.gain >= wanted.gain_margin
        and found.phase_deg >= wanted.phase_margin_deg
        and (wanted.max_sensitivity is None or found.sensitivity <= wanted.max_sensitivity)
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
