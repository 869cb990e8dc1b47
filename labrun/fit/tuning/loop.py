"""The loop as it runs on a bench, exactly: a held drive, the plant, the mean over a cycle, samples, computation."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.fit.transfer import StateSpace, TransferFunction

ComplexArray = NDArray[np.complex128]

_SHORT = 1e-6
"""A mean over less than this part of a step is the output itself: the difference of two integrals would be rounding."""
_SLOW, _FAST = 1e-3, 300.0
"""Frequencies looked at, over the slowest and the fastest time of the loop."""
_TURN_RAD = 0.05
"""Most that the dead time may turn the response from one frequency to the next."""
_TURNING = 100.0
"""Up to this frequency times the delay; beyond it a loop's gain is small or the same all the way round."""
_PER_DECADE = 200


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

    Parameters
    ----------
    plant
        Proper; its dead time is kept as it is.
    extra_s
        From sample to drive: computation, age of the sample.
    average_s
        The sample is the output's mean over so long; 0 takes the output itself.
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
