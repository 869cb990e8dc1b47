"""A plant between a held drive and a sample, exactly: dead time and averages of any length, no Pade."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.fit.transfer import TransferFunction

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_SHORT = 1e-6
"""A mean over less than this part of a step is the output itself: the difference of two integrals would be rounding."""


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

    def pulse_response(self, count: int) -> FloatArray:
        """Return the samples after a drive of 1 for one step, shape (count,)."""
        response = np.zeros(count)
        for tap in self.taps:
            state = self.input
            if tap.whole < count:
                response[tap.whole] += tap.from_drive
            for k in range(tap.whole + 1, count):
                response[k] += tap.from_state @ state
                state = self.transition @ state
        return response

    def at_rest(self, drive: float) -> FloatArray:
        """Return the state, shape (n,), after a drive has been held for long; the integral is 0."""
        size = len(self.input) - 1
        own = np.linalg.solve(np.eye(size) - self.transition[:size, :size], self.input[:size] * drive)
        return np.append(own, 0.0)


def sample_plant(
    plant: TransferFunction,
    step_s: float,
    *,
    extra_s: float = 0.0,
    average_s: float = 0.0,
    ahead_s: float = 0.0,
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
    ahead_s
        The sample is taken so much after the drive was set, less than a step: what happens between samples.
    """
    state, drive, output, direct = _state_space(plant)
    size = len(drive)
    # the output's integral is one more state, and the drive, which is held, one more still
    whole = np.zeros((size + 2, size + 2))
    whole[:size, :size], whole[:size, -1] = state, drive
    whole[size, :size], whole[size, -1] = output, direct
    late_s = plant.dead_s + extra_s - ahead_s
    if average_s > _SHORT * step_s:
        row = np.zeros(size + 2)
        row[size] = 1.0 / average_s
        taps: tuple[Tap, ...] = (
            _tap(whole, row, late_s, step_s),
            _tap(whole, -row, late_s + average_s, step_s),
        )
    else:
        taps = (_tap(whole, np.array([*output, 0.0, direct]), late_s, step_s),)
    stepped = _exponential(whole, step_s)
    return SampledPlant(stepped[:-1, :-1], stepped[:-1, -1], taps)


def _tap(whole: FloatArray, row: FloatArray, late_s: float, step_s: float) -> Tap:
    """Return what was `late_s` ago, just before whatever happened then: a sample is taken, then the drive is set."""
    # rounded up only where it really is a whole number of steps: 0.28 / 0.05 must not miss by the last bit
    steps = int(np.floor(late_s / step_s + 1e-9)) + 1
    part_s = min(max(steps * step_s - late_s, 0.0), step_s)
    seen = row @ _exponential(whole, part_s)
    return Tap(steps, seen[:-1], float(seen[-1]))


def _state_space(plant: TransferFunction) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return A, B, C, D of the plant without its dead time, in controllable form."""
    denominator = np.atleast_1d(np.asarray(plant.denominator, dtype=float))
    numerator = np.atleast_1d(np.asarray(plant.numerator, dtype=float))
    numerator = np.append(np.zeros(len(denominator) - len(numerator)), numerator) / denominator[0]
    denominator = denominator / denominator[0]
    size = len(denominator) - 1
    state = np.zeros((size, size))
    drive = np.zeros(size)
    if size:
        state[0], state[1:, :-1] = -denominator[1:], np.eye(size - 1)
        drive[0] = 1.0
    direct = float(numerator[0])
    return state, drive, numerator[1:] - direct * denominator[1:], direct


def _exponential(matrix: FloatArray, time_s: float) -> FloatArray:
    from scipy.linalg import expm

    return np.asarray(expm(matrix * time_s), dtype=float)
