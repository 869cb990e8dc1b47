"""How far a loop is from instability, on its exact frequency response."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.tuning.closed_loop import Gains
from labrun.fit.tuning.loop import ComplexArray, OpenLoop


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins of a loop; inf where the curve never comes there.

    Attributes
    ----------
    stable
        Whether the closed loop is; the others tell nothing if it is not.
    gain
        The loop gain may be so many times larger.
    phase_deg
        Least angle between -1 and a point of the curve at distance 1.
    delay_s
        Dead time that may be added.
    sensitivity
        Ms, the largest ``1 / |1 + L|``: its inverse is the curve's least distance from -1.
    crossover_rad_s
        Highest frequency with loop gain 1; 0 if there is none.
    phase_crossover_rad_s
        Frequency at which the loop would oscillate; inf if it would not.
    """

    stable: bool
    gain: float
    phase_deg: float
    delay_s: float
    sensitivity: float
    crossover_rad_s: float
    phase_crossover_rad_s: float


def margins(gains: Gains, loop: OpenLoop, *, refine: bool = True) -> Margins:
    """Return the margins of a loop with its controller.

    The plant must be stable: then a loop of small gain, driving the right way, is stable, and it stays so up to the
    gain at which its curve first passes through -1. That holds for dead times of any length. `refine`: find crossings
    exactly; without, they are interpolated on the grid, to some 1e-4: for many plants.
    """
    omega, response = loop.grid_rad_s, loop.grid_response
    curve = gains.frequency_response(omega, loop.step_s) * response

    def at(frequency: float) -> complex:
        if not refine:
            return complex(np.interp(frequency, omega, curve))
        point = np.array([frequency])
        return complex((gains.frequency_response(point, loop.step_s) * loop.frequency_response(point))[0])

    gain, oscillates = _gain_margin(omega, curve, at, refine=refine, sampled=loop.rate_hz is not None)
    # a gain that drives the wrong way is not stable at any size where the loop settles by it
    wrong_way = gains.i_per_s * loop.gain < 0 or (gains.i_per_s == 0 and 1.0 + gains.p * loop.gain <= 0)
    phase_deg, delay_s, crossover = math.inf, math.inf, 0.0
    for frequency in _crossings(omega, np.abs(curve) - 1.0, (lambda w: abs(at(w)) - 1.0) if refine else None):
        angle = math.degrees(np.angle(at(frequency))) % 360.0  # 180 is -1
        phase_deg = min(phase_deg, abs(angle - 180.0))
        lag = (angle - 180.0) % 360.0
        delay_s = min(delay_s, math.radians(lag) / frequency)
        crossover = max(crossover, frequency)
    return Margins(
        gain > 1.0 and not wrong_way,
        gain,
        phase_deg,
        delay_s,
        _sensitivity(omega, curve, at),
        crossover,
        oscillates,
    )


def ultimate(loop: OpenLoop) -> tuple[float, float]:
    """Return the gain of a proportional controller at which the loop oscillates, and the frequency, rad/s.

    The gain has the sign that the plant's static gain asks for; both are inf if no gain does it.
    """
    found = margins(Gains(math.copysign(1.0, loop.gain)), loop)
    return math.copysign(found.gain, loop.gain), found.phase_crossover_rad_s


def allowed_gain(
    curve: ComplexArray, gain_margin: float, phase_margin_deg: float, max_sensitivity: float | None
) -> float:
    """Return the largest factor of a loop's gain that keeps margins, on the points of its curve.

    At no smaller factor are they lost either, so that a conditionally stable loop is never taken. `curve`, (n,): the
    open loop on a dense grid. `gain_margin`, `phase_margin_deg`, `max_sensitivity`: what is to be kept; None asks for
    no sensitivity.
    """
    size, angle = np.abs(curve), np.abs(np.angle(-curve))
    limit = np.inf
    inside = angle <= math.radians(phase_margin_deg)
    if inside.any():
        limit = 1.0 / float(np.max(size[inside]))
    below = curve.imag[:-1] * curve.imag[1:] <= 0
    negative = below & (np.minimum(curve.real[:-1], curve.real[1:]) < 0)
    if negative.any():
        reach = np.maximum(size[:-1], size[1:])[negative]
        limit = min(limit, 1.0 / (gain_margin * float(np.max(reach))))
    limit = min(limit, 1.0 / (gain_margin * float(size[-1])) if curve.real[-1] < 0 else limit)
    if max_sensitivity is None:
        return limit
    # |1 + k L| = 1/Ms: k^2 |L|^2 + 2 k Re L + 1 - 1/Ms^2 = 0
    least = 1.0 - 1.0 / max_sensitivity**2
    root = curve.real**2 - size**2 * least
    touching = (root >= 0) & (curve.real < 0)
    if touching.any():
        factors = (-curve.real[touching] - np.sqrt(root[touching])) / size[touching] ** 2
        limit = min(limit, float(np.min(factors)))
    return limit


def _gain_margin(
    omega: FloatArray, curve: ComplexArray, at: Callable[[float], complex], *, refine: bool, sampled: bool
) -> tuple[float, float]:
    """Return gain margin and its frequency: where the curve crosses the negative axis farthest out."""
    reach, where = 0.0, math.inf
    for frequency in _crossings(omega, curve.imag, (lambda w: at(w).imag) if refine else None):
        value = at(frequency)
        if value.real < 0 and -value.real > reach:
            reach, where = -value.real, frequency
    # at the Nyquist frequency the curve of samples ends on the real axis
    if sampled and -curve[-1].real > reach:
        reach, where = -float(curve[-1].real), float(omega[-1])
    return (1.0 / reach if reach > 0 else math.inf), where


def _crossings(
    omega: FloatArray, values: FloatArray, function: Callable[[float], float] | None
) -> list[float]:
    """Return where a function that has been sampled changes its sign; without it, where a straight line would."""
    from scipy.optimize import brentq

    changes = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    if function is None:
        share = values[changes] / (values[changes] - values[changes + 1])
        return [float(w) for w in omega[changes] + share * (omega[changes + 1] - omega[changes])]
    found = []
    for index in changes:
        low, high = float(omega[index]), float(omega[index + 1])
        if function(low) * function(high) < 0:
            found.append(float(brentq(function, low, high, xtol=1e-12 * high)))
    return found


def _sensitivity(omega: FloatArray, curve: ComplexArray, at: Callable[[float], complex]) -> float:
    from scipy.optimize import minimize_scalar

    distance = np.abs(1.0 + curve)
    worst = int(np.argmin(distance))
    low, high = float(omega[max(worst - 1, 0)]), float(omega[min(worst + 1, len(omega) - 1)])
    found = minimize_scalar(lambda w: abs(1.0 + at(w)), bounds=(low, high), method="bounded")
    least = min(float(found.fun), float(distance[worst]))
    return 1.0 / least if least > 0 else math.inf
