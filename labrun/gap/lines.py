"""Forces that come back along a coordinate, read from the lines of what is missing over it, without a simulation.

A fit finds the number of periods only from within a part of a period over the whole travel: over many turns a grid of
starts would be far too coarse, or far too long. And where such a force holds the motion in wells, a simulation that
falls into the wrong one never comes back.
"""

from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap.candidates import Candidate, site_courses
from labrun.gap.held_out import mean_residuals
from labrun.gap.motion import smoothed
from labrun.gap.noise import fit_whitener, quantum

_LINES = 2
"""Spectral lines of what is missing over a coordinate that are starts, too."""
_SMALL_WAVE = 0.02
"""Amplitude at which a line of unknown phase starts."""
_SHOWS_COORDINATE = 0.01
"""Part of its variation by which an output may miss a line over the coordinate and still shows it."""
_BINS_A_PERIOD = 8
"""Bins over two of the shortest periods."""
_NEIGHBOURS = 20
"""Frequencies on both sides of a line that its power is compared with, in units of its width."""
_STEPS_A_PERIOD = 6.0
"""Samples over the shortest period, at least."""
_LINE_SHARE = 0.2
"""Part of the squares of a missing force in one line from which it holds the motion in wells."""
_FEWEST_WELLS = 3.0
"""Wells that the motion must pass for that."""


def line_starts(problem: Problem, z: FloatArray, candidate: Candidate) -> list[tuple[float, ...]]:
    """Return where fits of a force that is periodic along its coordinate start; nothing for any other candidate.

    Periods, sine and cosine, in multiples of what is typical at the site.
    """
    missing = _missing(problem, z, candidate)
    if missing is None or candidate.attached is None:
        return []
    limits = {
        parameter.name: (parameter.lower, parameter.upper)
        for parameter in candidate.attached.effect.parameters
    }
    starts: list[tuple[float, ...]] = []
    for periods, wave in missing.lines[:_LINES]:
        sine, cosine = np.clip(wave.imag, *limits["sine"]), np.clip(-wave.real, *limits["cosine"])
        starts.append((periods, float(sine), float(cosine)))
    for periods in missing.unpredicted[:_LINES]:  # of these the phase is not known
        starts += [(periods, _SMALL_WAVE, sign * _SMALL_WAVE) for sign in (1.0, -1.0)]
    return starts


def growth_in_wells(problem: Problem, z: FloatArray, candidate: Candidate) -> float:
    """Return how fast what differs grows between the wells of a missing force, 1/s; 0 where there plainly are none."""
    missing, scale = _missing(problem, z, candidate), candidate.scale
    if missing is None or scale is None or not missing.accelerates or not missing.lines:
        return 0.0
    periods, wave = missing.lines[0]
    if periods < _FEWEST_WELLS * np.pi or abs(wave) ** 2 / 2.0 < _LINE_SHARE * missing.square:
        return 0.0
    return float(np.sqrt(abs(wave) * scale.force * periods * scale.of("per-coordinate") / scale.inertia))


@dataclass(frozen=True)
class _Missing:
    """What is missing at a site over its coordinate, in multiples of what is typical there.

    Attributes
    ----------
    accelerates
        Whether it was read from an output's acceleration, not from the outputs themselves.
    lines
        Periods, and complex amplitudes: the force is the real part of amplitude times exp(i periods coordinate).
    square
        Mean square of the force.
    unpredicted
        Periods of the lines of what the output's own past does not predict: of small forces beside noise of a colour.
    """

    accelerates: bool
    lines: list[tuple[float, complex]]
    square: float
    unpredicted: list[float]


def _missing(problem: Problem, z: FloatArray, candidate: Candidate) -> _Missing | None:
    """Return what is missing at the site of a candidate that comes back along its coordinate.

    Where an output shows the coordinate, the force is what accelerates it beyond the simulation, and acts where it was
    measured; else it is taken to change the outputs at once, where it is simulated to be.
    """
    attached, scale = candidate.attached, candidate.scale
    if attached is None or scale is None or not attached.effect.periodic:
        return None
    courses = site_courses(problem, z)
    if courses is None:
        return None
    (limits,) = [
        (parameter.lower, parameter.upper)
        for parameter in attached.effect.parameters
        if parameter.name == "periods"
    ]
    index = [site.name for site in problem.model.sites].index(attached.site)
    at = np.concatenate([course[:, index, 0] for course, _ in courses])
    outputs = np.concatenate([shown for _, shown in courses])
    residuals, trials = mean_residuals(problem, z), problem.data.trials
    column, slope, zero = _shown(at, outputs) if scale.inertia > 0.0 else (None, 1.0, 0.0)
    if column is None:
        force = np.sum(np.concatenate(residuals) / problem.spread, axis=1)
        lines, square = _lines(at * scale.of("per-coordinate"), force, *limits), float(np.var(force))
        return _Missing(False, [(periods, wave) for periods, wave, _ in lines], square, [])
    steps = float(quantum(problem.data)[column]) / abs(slope) * scale.of("per-coordinate")
    limits = limits[0], min(limits[1], 2.0 * np.pi / (_STEPS_A_PERIOD * steps))
    columns = [residual[:, [column]] for residual in residuals]
    measured = np.concatenate([smoothed(trial.time_s, trial.outputs[:, [column]])[0] for trial in trials])[
        :, 0
    ]
    along = (measured - zero) / slope * scale.of("per-coordinate")
    beyond = [smoothed(trial.time_s, values)[2] for trial, values in zip(trials, columns, strict=True)]
    force = np.concatenate(beyond)[:, 0] / slope * scale.inertia / scale.force
    lines = _lines(along, force, *limits)
    size = max(float(np.std(np.concatenate(columns))), 1e-300)
    past = fit_whitener([residual / size for residual in columns])
    white = np.concatenate([past.white(residual / size) for residual in columns])[:, 0]
    sharp = sorted(_lines(along, white, *limits, count=4 * _LINES), key=lambda line: -line[2])
    return _Missing(
        True,
        [(periods, wave) for periods, wave, _ in lines],
        float(np.var(force)),
        [line[0] for line in sharp],
    )


def _shown(coordinate: FloatArray, outputs: FloatArray) -> tuple[int | None, float, float]:
    """Return the output that shows a coordinate, and its slope and zero by it; None where none does."""
    if np.ptp(coordinate) > 0.0:
        for column, values in enumerate(outputs.T):
            slope, zero = np.polyfit(coordinate, values, 1)
            away = np.std(values - slope * coordinate)
            if slope != 0.0 and away <= _SHOWS_COORDINATE * np.std(values):
                return column, float(slope), float(zero)
    return None, 1.0, 0.0


def _lines(
    coordinate: FloatArray, signal: FloatArray, lower: float, upper: float, count: int = _LINES
) -> list[tuple[float, complex, float]]:
    """Return the largest lines of a signal over its coordinate: periods, amplitude, power beside its neighbours'."""
    from scipy.ndimage import median_filter

    travel = float(np.ptp(coordinate))
    if not travel > 0.0 or upper <= lower:
        return []
    width = np.pi / upper / _BINS_A_PERIOD * 2.0
    bins = max(int(np.ceil(travel / width)), 2)
    begin = float(np.min(coordinate))
    held = np.histogram(coordinate, bins, (begin, begin + bins * width), weights=signal - np.mean(signal))[0]
    length = 4 * bins  # lines are found to a part of their width
    periods = 2.0 * np.pi * np.arange(length // 2 + 1) / (length * width)
    waves = np.fft.rfft(held, length) * np.exp(-1j * periods * (begin + width / 2.0)) * 2.0 / len(signal)
    power = np.where((periods >= lower) & (periods <= upper), np.square(np.abs(waves)), 0.0)
    around = median_filter(np.square(np.abs(waves)), size=4 * _NEIGHBOURS + 1, mode="nearest")
    lines: list[tuple[float, complex, float]] = []
    while len(lines) < count and power.any():
        top = int(np.argmax(power))
        lines.append((float(periods[top]), complex(waves[top]), float(power[top] / max(around[top], 1e-300))))
        power[np.abs(periods - periods[top]) < 2.0 * np.pi / travel] = 0.0
    return lines
