"""The loop as it runs on a bench, exactly: gains, plant, samples; and how far it is from instability."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.fit.transfer import StateSpace, TransferFunction

ComplexArray = NDArray[np.complex128]

_SHORT = 1e-6
"""A mean over less than this part of a step is the output itself: the difference of two integrals would be rounding."""
_SLOW, _FAST = 1e-4, 300.0
"""Frequencies looked at, over the slowest and the fastest time of the loop."""
_TURN_RAD = 0.05
"""Most that the dead time may turn the response from one frequency to the next."""
_TURNING = 100.0
"""Up to this frequency times the delay; beyond it a loop's gain is small or the same all the way round."""
_PER_DECADE = 200
_SPLINE_STRIDE = 4
"""Every so many points of that grid carry the cubic spline that python-control interpolates with, to some 1e-7."""
_KNOTS_ASIDE, _KNOTS_APART = 4, 12
"""It goes through so many of them on either side of a crossing, and through every twelfth elsewhere."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a controller, in the drive's unit per unit of the feedback.

    Attributes
    ----------
    p, i_per_s, d_s, filter_s
        Parallel form: ``p + i/s + d s / (filter_s s + 1)``.
    feedforward
        What the drive is given per unit of reference: the inverse of the plant's static gain, or None.
    lead_s
        How far ahead on the reference the feed-forward looks.
    """

    p: float
    i_per_s: float = 0.0
    d_s: float = 0.0
    filter_s: float = 0.0
    feedforward: float | None = None
    lead_s: float = 0.0

    def scaled(self, factor: float) -> "Gains":
        """Return them with the feedback's gains times a factor."""
        return replace(self, p=self.p * factor, i_per_s=self.i_per_s * factor, d_s=self.d_s * factor)

    def i_per_sample(self, rate_hz: float) -> float:
        """Return the integral gain that is summed once a sample."""
        return self.i_per_s / rate_hz

    def steady_error(self, gain: float) -> float:
        """Return what is left of a constant reference, relative to it: ``(1 - K F) / (1 + K p)``, 0 with an integral.

        `gain`: K, the plant's static gain; F is the feed-forward's, 0 without one.
        """
        if self.i_per_s:
            return 0.0
        return (1.0 - gain * (self.feedforward or 0.0)) / (1.0 + gain * self.p)

    def frequency_response(self, omega_rad_s: FloatArray, step_s: float) -> ComplexArray:
        """Return drive over error, shape of `omega_rad_s`; of samples `step_s` apart, or continuous if that is 0.

        The sum of errors includes the present one; the derivative is a filtered backward difference.
        """
        s = 1j * omega_rad_s
        if step_s == 0:
            return np.asarray(self.p + self.i_per_s / s + self.d_s * s / (self.filter_s * s + 1.0))
        change = -np.expm1(-s * step_s)  # 1 - 1/z
        share = step_s / (self.filter_s + step_s)
        rate = share * change / step_s / (1.0 - (1.0 - share) * (1.0 - change))
        return np.asarray(self.p + self.i_per_s * step_s / change + self.d_s * rate)

    @property
    def plugin(self) -> str:
        """Name of the controller plugin that takes `settings`."""
        return "pid" if self.feedforward is None else "feedforward+pid"

    def settings(self, period_s: float, i_per: str, model: dict[str, Any] | None) -> dict[str, Any]:
        """Return the keys of the controller plugin.

        `period_s`: from step to step, for an integral per "sample"; `i_per` may be "second". `model`: keys of that
        whose static gain a feed-forward inverts; it needs one.
        """
        keys: dict[str, Any] = {"p": self.p}
        if self.i_per_s:
            keys |= {"i": self.i_per_s * (period_s if i_per == "sample" else 1.0), "i_per": i_per}
        if self.d_s:
            keys |= {"d": self.d_s, "filter_s": self.filter_s}
        if self.feedforward is not None:
            keys |= {"model": dict(model or {})} | ({"lead_s": self.lead_s} if self.lead_s else {})
        return keys


@dataclass(frozen=True, slots=True)
class Tap:
    """A value of the plant's state, `whole` steps and a part of one before now.

    ``from_state @ x[k - whole] + from_drive * u[k - whole]``; x is the state at the beginning of a step,
    u the drive that is held from then on.
    """

    whole: int
    from_state: FloatArray
    from_drive: float


@dataclass(frozen=True, slots=True)
class SampledPlant:
    """State of a plant from step to step, and what a sample takes of it.

    The state is the plant's own and the integral of its output, so that a mean over any time is a difference of two
    values of it (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., sections 2.3 and 2.7).

    Attributes
    ----------
    transition : (n, n)
    input : (n,)
        ``x[k+1] = transition @ x[k] + input * u[k]``.
    taps
        Their sum is the sample.
    """

    transition: FloatArray
    input: FloatArray
    taps: tuple[Tap, ...]

    def frequency_response(self, z: ComplexArray) -> ComplexArray:
        """Return sample over drive at points z of the complex plane, none of them 1; shape of `z`."""
        size = len(self.input)
        matrices = z[..., None, None] * np.eye(size) - self.transition
        states = np.linalg.solve(matrices, np.broadcast_to(self.input, (*z.shape, size))[..., None])[..., 0]
        total = np.zeros(z.shape, dtype=complex)
        for tap in self.taps:
            total += z ** float(-tap.whole) * (states @ tap.from_state + tap.from_drive)
        return total

    def at_rest(self, drive: float) -> FloatArray:
        """Return the state, shape (n,), after a drive has been held for long; the integral is 0."""
        size = len(self.input) - 1
        own = np.linalg.solve(np.eye(size) - self.transition[:size, :size], self.input[:size] * drive)
        return np.append(own, 0.0)


def sample_plant(
    plant: TransferFunction, step_s: float, *, extra_s: float = 0.0, average_s: float = 0.0
) -> SampledPlant:
    """Return a plant whose drive is held for `step_s` and whose output is sampled as often.

    `plant`: proper; its dead time is kept as it is. `extra_s`: from sample to drive: computation, age of the sample.
    `average_s`: the sample is the output's mean over so long; 0 takes the output itself.
    """
    system = StateSpace(plant.numerator, plant.denominator, 1.0)
    size = system.size
    # the output's integral is one more state, and the drive, which is held, one more still
    whole = np.zeros((size + 2, size + 2))
    whole[:size, :size], whole[:size, -1] = system.a, system.b
    whole[size, :size], whole[size, -1] = system.c, system.through
    late_s = plant.dead_s + extra_s
    if average_s > _SHORT * step_s:
        row = np.zeros(size + 2)
        row[size] = 1.0 / average_s
        taps: tuple[Tap, ...] = (
            _tap(whole, row, late_s, step_s),
            _tap(whole, -row, late_s + average_s, step_s),
        )
    else:
        taps = (_tap(whole, np.array([*system.c, 0.0, system.through]), late_s, step_s),)
    stepped = _exponential(whole, step_s)
    return SampledPlant(stepped[:-1, :-1], stepped[:-1, -1], taps)


def _tap(whole: FloatArray, row: FloatArray, late_s: float, step_s: float) -> Tap:
    """Return what was `late_s` ago, just before whatever happened then: a sample is taken, then the drive is set."""
    # rounded up only where it really is a whole number of steps: 0.28 / 0.05 must not miss by the last bit
    steps = int(np.floor(late_s / step_s + 1e-9)) + 1
    part_s = min(max(steps * step_s - late_s, 0.0), step_s)
    seen = row @ _exponential(whole, part_s)
    return Tap(steps, seen[:-1], float(seen[-1]))


def _exponential(matrix: FloatArray, time_s: float) -> FloatArray:
    from scipy.linalg import expm

    return np.asarray(expm(matrix * time_s), dtype=float)


@dataclass(frozen=True)
class OpenLoop:
    """Everything of a loop but its controller.

    Attributes
    ----------
    plant
        What the drive does to the output.
    rate_hz
        Of the controller; None is one that acts continuously, for comparison with textbooks.
    compute_s
        From the newest sample to the drive it leads to.
    average_s
        The feedback is the output's mean over so long, a gait cycle; 0 is the output itself.
    """

    plant: TransferFunction
    rate_hz: float | None = None
    compute_s: float = 0.0
    average_s: float = 0.0

    @property
    def step_s(self) -> float:
        """Time from sample to sample; 0 if it is continuous."""
        return 0.0 if self.rate_hz is None else 1.0 / self.rate_hz

    @property
    def gain(self) -> float:
        """Static gain of the plant."""
        return float(self.plant.gain)

    @property
    def delay_s(self) -> float:
        """Dead time and what acts like one: computation, half a sample of holding, half an average."""
        return float(self.plant.dead_s) + self.compute_s + 0.5 * (self.step_s + self.average_s)

    @property
    def lags_s(self) -> FloatArray:
        """Time constants of the plant's poles, largest first."""
        sizes = np.abs(np.atleast_1d(np.asarray(self.plant.poles)))
        return np.sort(1.0 / sizes[sizes > 0])[::-1]

    @cached_property
    def sampled(self) -> SampledPlant:
        """From drive to feedback, sample by sample."""
        return sample_plant(self.plant, self.step_s, extra_s=self.compute_s, average_s=self.average_s)

    def frequency_response(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return feedback over drive, shape of `omega_rad_s` (positive, below the Nyquist frequency).

        Of a sampled loop it is that of the samples, with every alias: the response on the unit circle.
        """
        if self.rate_hz is not None:
            return self.sampled.frequency_response(np.exp(1j * omega_rad_s * self.step_s))
        response = np.asarray(self.plant.frequency_response(omega_rad_s), dtype=complex)
        s = 1j * omega_rad_s
        response = response * np.exp(-s * self.compute_s)
        if self.average_s > 0:
            response = response * (-np.expm1(-s * self.average_s) / (s * self.average_s))
        return np.asarray(response, dtype=complex)

    @cached_property
    def grid_rad_s(self) -> FloatArray:
        """Frequencies on which margins are sought, shape (n,): dense where dead time turns the phase."""
        times = [value for value in (*self.lags_s, self.delay_s) if value > 0] or [1.0]
        low = _SLOW / max(times)
        high = _FAST / min(times) if self.rate_hz is None else np.pi * self.rate_hz
        low = min(low, 0.01 * high)
        decades = float(np.log10(high / low))
        even = np.logspace(np.log10(low), np.log10(high), int(_PER_DECADE * decades) + 2)
        late_s = 2.0 * self.delay_s
        fine_to = min(high, _TURNING / late_s) if late_s > 0 else low
        fine = np.linspace(low, fine_to, max(int(fine_to * late_s / _TURN_RAD), 2))
        grid = np.unique(np.concatenate([even, fine]))
        # the Nyquist frequency itself is the last point: a fast loop may become unstable just there
        return np.asarray(grid[grid <= high])

    @cached_property
    def grid_response(self) -> ComplexArray:
        """Feedback over drive on `grid_rad_s`."""
        return self.frequency_response(self.grid_rad_s)


def horizon_s(loop: OpenLoop, gains: Gains | None = None) -> float:
    """Return how long a step is followed: many times what delays and lags it."""
    slow = 2.0 * loop.delay_s + float(np.sum(loop.lags_s))
    if gains is not None and gains.i_per_s:
        # the slow tail of a weak integral
        slow = max(slow, abs((1.0 + gains.p * loop.gain) / (gains.i_per_s * loop.gain)))
    return 12.0 * slow


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


def margins(gains: Gains, loop: OpenLoop) -> Margins:
    """Return the margins of a loop with its controller, by python-control from its exact frequency response.

    The plant must be stable: then a loop of small gain, driving the right way, is stable, and it stays so up to the
    gain at which its curve first passes through -1. That holds for dead times of any length.
    """
    import control

    omega, curve = (
        loop.grid_rad_s,
        gains.frequency_response(loop.grid_rad_s, loop.step_s) * loop.grid_response,
    )
    used = slice(None, _last_decisive(curve) + 1, _SPLINE_STRIDE)
    knots = _knots(curve[used])
    response = control.FRD(curve[used][knots], omega[used][knots], smooth=True)
    gain_margins, phases_deg, distances, oscillations, crossovers, _ = control.stability_margins(
        response, returnall=True
    )
    gain, oscillates = min(zip(gain_margins, oscillations, strict=True), default=(math.inf, math.inf))
    # at the Nyquist frequency the curve of samples ends on the real axis
    if loop.rate_hz is not None and curve[-1].real < 0 and -1.0 / curve[-1].real < gain:
        gain, oscillates = -1.0 / curve[-1].real, omega[-1]
    # a gain that drives the wrong way is not stable at any size where the loop settles by it
    wrong_way = gains.i_per_s * loop.gain < 0 or (gains.i_per_s == 0 and 1.0 + gains.p * loop.gain <= 0)
    least = float(min(*distances, np.min(np.abs(1.0 + curve)), math.inf))
    return Margins(
        stable=bool(gain > 1.0 and not wrong_way),
        gain=float(gain),
        phase_deg=float(np.min(np.abs(phases_deg), initial=math.inf)),
        delay_s=float(np.min(np.radians(phases_deg % 360.0) / crossovers, initial=math.inf)),
        sensitivity=1.0 / least if least > 0 else math.inf,
        crossover_rad_s=float(np.max(crossovers, initial=0.0)),
        phase_crossover_rad_s=float(oscillates),
    )


def _knots(curve: ComplexArray) -> NDArray[np.bool_]:
    """Return which points of a curve its spline goes through, (n,): all near a margin, a few elsewhere.

    python-control evaluates the spline point by point, and several times at every point it goes through.
    """
    distance = np.abs(1.0 + curve)
    knots = np.zeros(len(curve), dtype=bool)
    for side in (curve.imag > 0, np.abs(curve) > 1.0, np.diff(distance, prepend=distance[0]) > 0):
        near = np.flatnonzero(side[1:] != side[:-1])[:, None] + np.arange(-_KNOTS_ASIDE, _KNOTS_ASIDE + 2)
        knots[np.clip(near, 0, len(curve) - 1)] = True
    knots[::_KNOTS_APART] = knots[: 2 * _KNOTS_ASIDE] = knots[-_KNOTS_ASIDE:] = True
    return knots


def ultimate(loop: OpenLoop) -> tuple[float, float]:
    """Return the gain of a proportional controller at which the loop oscillates, and the frequency, rad/s.

    The gain has the sign that the plant's static gain asks for; both are inf if no gain does it.
    """
    loop_margins = margins(Gains(math.copysign(1.0, loop.gain)), loop)
    return math.copysign(loop_margins.gain, loop.gain), loop_margins.phase_crossover_rad_s


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


def _last_decisive(curve: ComplexArray) -> int:
    """Return the index in an open loop's curve, (n,), beyond which no margin can lie.

    Where the curve's phase first passes 180 deg, the loop reaches as far along the negative real axis as the curve is
    large there. A point farther along the curve than any that is as large, or of size 1, comes nearer to -1 nowhere.
    """
    size, phase_rad = np.abs(curve), np.unwrap(np.angle(curve))
    beyond = np.flatnonzero(np.abs(phase_rad) >= np.pi)
    if not len(beyond):
        return len(curve) - 1
    reach = float(np.min(size[max(beyond[0] - 1, 0) : beyond[0] + 1]))
    last = int(np.flatnonzero(size >= min(1.0, reach))[-1])
    return min(last + 2 * _SPLINE_STRIDE, len(curve) - 1)
