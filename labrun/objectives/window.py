"""Which part of a recording counts where joints share no cycle, and what the cycles it cuts can do to a mean.

A mean over whole cycles is free of what only goes to and fro. Joints of different frequencies leave no window that is
whole for all of them, and for what their product makes: sums and differences (beats) of their frequencies. Of a line of
amplitude a at frequency f, a window of length L leaves at most ``a |sin(pi f L)| / (pi f L)`` in the mean, whatever its
phase: the Dirichlet kernel of a rectangular window (Harris 1978, doi:10.1109/PROC.1978.10837).
"""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labrun.arrays import FloatArray
from labrun.experiment import Averaging
from labrun.signals import Signal

RESIDUAL = 0.02
"""Share of a cycle that a joint may be short of a whole number, for a window to count as one of beats."""
_GRID = 0.002
"""Steps of the lengths that are looked at, in cycles of the fastest joint."""
_MOST_LENGTHS = 200_000
_HARMONICS = 4
"""Forces of a fluid go with the square of speed: a joint leaves multiples of its frequency, higher ones little."""
_CYCLES_TO_SEE = 2.0
"""A line needs so many cycles in the window to be told apart from the mean (a Hann window is as wide)."""
_SAME_HZ = 1e-9


@dataclass(frozen=True, slots=True)
class _Line:
    """A frequency that a signal may hold; of a beat, the two that make it."""

    frequency_hz: float
    beat_of: tuple[float, float] | None = None


def averaging_window(
    start_s: float, end_s: float, frequencies_hz: Sequence[float], average: Averaging, own_hz: float | None
) -> tuple[float, float] | None:
    """Return the part of a recording that counts; it ends with the recording, when what began has settled most.

    Parameters
    ----------
    start_s, end_s
        What may count.
    frequencies_hz
        Of every joint that moves.
    average
        "beats": the longest window in which every joint makes a whole number of cycles but for `RESIDUAL`, or, where
        there is none, the one that cuts least. Else whole cycles of one joint.
    own_hz
        The frequency of that joint.

    Returns
    -------
    tuple of float, or None
        None if there is no whole cycle of that joint, or of the slowest one.
    """
    available_s = end_s - start_s
    if average != "beats":
        if own_hz is None:
            return None
        cycles = math.floor(available_s * own_hz * (1 + 1e-9) + 1e-9)
        return (max(start_s, end_s - cycles / own_hz), end_s) if cycles else None
    length_s = _of_beats(available_s, tuple(sorted(set(frequencies_hz))))
    return None if length_s is None else (max(start_s, end_s - length_s), end_s)


@lru_cache(maxsize=512)
def _of_beats(available_s: float, frequencies_hz: tuple[float, ...]) -> float | None:
    if not frequencies_hz:
        return available_s if available_s > 0 else None
    shortest_s = 1.0 / frequencies_hz[0]
    if available_s < shortest_s * (1 - 1e-9):
        return None
    step_s = _GRID / frequencies_hz[-1]
    shortest_s = max(shortest_s, available_s - step_s * _MOST_LENGTHS)
    wholes = [np.arange(math.ceil(shortest_s * f), available_s * f + 1e-9) / f for f in frequencies_hz]
    lengths = np.unique(np.concatenate([np.arange(available_s, shortest_s, -step_s), *wholes]))[::-1]
    turns = lengths[:, None] * np.array(frequencies_hz)
    residual = np.abs(turns - np.round(turns)).max(axis=1)
    fits = residual <= RESIDUAL
    if not fits.any():
        cut = sum(left_over(line.frequency_hz, lengths) for line in _lines(frequencies_hz))
        return float(lengths[np.argmin(cut)])
    first = int(np.argmax(fits))
    last = first + int(np.argmin(np.append(fits[first:], False)))
    return float(lengths[first + int(np.argmin(residual[first:last]))])


def left_over(frequency_hz: float, length_s: FloatArray | float) -> FloatArray:
    """Return the greatest share of a line's amplitude that a window leaves in the mean, 0 to 1."""
    return np.asarray(np.abs(np.sinc(frequency_hz * np.asarray(length_s))))


def _lines(frequencies_hz: Iterable[float]) -> list[_Line]:
    """Return harmonics of each frequency, and sums and differences of each two."""
    own = sorted(set(frequencies_hz))
    lines = [_Line(k * f) for f in own for k in range(1, _HARMONICS + 1)]
    for first, other in itertools.combinations(own, 2):
        lines += [_Line(first + other), _Line(other - first, (first, other))]
    return sorted(
        (line for line in lines if line.frequency_hz > _SAME_HZ), key=lambda line: line.frequency_hz
    )


def truncation_bound(signal: Signal, frequencies_hz: Iterable[float]) -> float:
    """Return a bound of what cut cycles may have added to the mean of a signal, or taken from it, in its unit.

    The amplitude of each line is read from the signal itself, under a Hann window. A beat of which the signal holds
    less than two cycles has at most the amplitude with which, at its flattest, it would swing as far as the means over
    cycles do; and at most that of the sum of the same two frequencies, which the product of two sines makes as strong.
    Lines that the window cannot tell apart count once; the phases are taken at their worst. `signal`: what the mean is
    taken of; at least two samples. `frequencies_hz`: of every joint that moves.
    """
    length_s = float(signal.time_s[-1] - signal.time_s[0])
    lines = _lines(frequencies_hz)
    if not lines:
        return 0.0
    total, cell = 0.0, [lines[0]]
    for line in [*lines[1:], None]:
        if line is not None and (line.frequency_hz - cell[0].frequency_hz) * length_s < 1.0:
            cell.append(line)
            continue
        size = max(_amplitude(signal, candidate, length_s) for candidate in cell)
        total += size * max(float(left_over(candidate.frequency_hz, length_s)) for candidate in cell)
        cell = [] if line is None else [line]
    return total


def _amplitude(signal: Signal, line: _Line, length_s: float) -> float:
    """Return the amplitude at a line, or the greatest it can have where it is too slow to be seen."""
    if line.beat_of is None or line.frequency_hz * length_s >= _CYCLES_TO_SEE:
        return _seen(signal, line.frequency_hz, length_s)
    return min(_seen(signal, sum(line.beat_of), length_s), _swung(signal, line.frequency_hz, line.beat_of))


def _seen(signal: Signal, frequency_hz: float, length_s: float) -> float:
    """Return the amplitude at a frequency, under a Hann window if it makes enough cycles for one."""
    time_s, values = signal.time_s - signal.time_s[0], signal.values
    wide = frequency_hz * length_s >= _CYCLES_TO_SEE
    weight = 1.0 - np.cos(2.0 * np.pi * time_s / length_s) if wide else np.ones(len(time_s))
    scale = float(np.trapezoid(weight, time_s))
    mean = float(np.trapezoid(weight * values, time_s)) / scale
    turn = np.exp(-2j * np.pi * frequency_hz * time_s)
    return float(2.0 * abs(np.trapezoid(weight * (values - mean) * turn, time_s)) / scale)


def _swung(signal: Signal, frequency_hz: float, beat_of: tuple[float, float]) -> float:
    """Return the greatest amplitude of a slow beat that moves means over a cycle of either joint no more than is seen.

    A line of amplitude a swings least about an extremum: by a (1 - cos(pi f L)) over a length L.
    """
    step_s = float(np.median(np.diff(signal.time_s)))
    time_s = np.arange(signal.time_s[0], signal.time_s[-1], step_s)
    course = np.interp(time_s, signal.time_s, signal.values)
    kept = 1.0
    for one_hz in beat_of:
        count = max(1, round(1.0 / (one_hz * step_s)))
        if len(course) <= count:
            return math.inf
        total = np.concatenate([[0.0], np.cumsum(course)])
        course = (total[count:] - total[:-count]) / count
        kept *= float(left_over(frequency_hz, 1.0 / one_hz))
    turn = min(frequency_hz * len(course) * step_s, 1.0)
    return float(np.ptp(course)) / max(kept * (1.0 - math.cos(math.pi * turn)), 1e-12)
