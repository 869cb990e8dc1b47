"""Gains by Skogestad's rules (SIMC), for a plant of first or second order in place of one of any order."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from labrun.errors import FitError
from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.loop import Gains, OpenLoop

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
