"""Test signals: what a programme commands."""

import numpy as np

from .plant import FloatArray


def sine(time_s: FloatArray, amplitude: float, frequency_hz: float, ramp_s: float = 0.0) -> FloatArray:
    """Return a sine that starts at zero, its amplitude rising over `ramp_s`."""
    grow = np.minimum(time_s / ramp_s, 1.0) if ramp_s > 0 else 1.0
    return np.asarray(amplitude * grow * np.sin(2 * np.pi * frequency_hz * time_s))


def chirp(time_s: FloatArray, amplitude: float, low_hz: float, high_hz: float) -> FloatArray:
    """Return a sine whose frequency rises linearly."""
    sweep = 0.5 * (high_hz - low_hz) / time_s[-1] * time_s**2
    return np.asarray(amplitude * np.sin(2 * np.pi * (low_hz * time_s + sweep)))


def multisine(time_s: FloatArray, amplitude: float, lines_hz: FloatArray, phases: FloatArray) -> FloatArray:
    """Return a sum of sines of equal size, scaled to the amplitude, rising from zero in half a second."""
    total = np.sin(2 * np.pi * lines_hz[:, None] * time_s + phases[:, None]).sum(axis=0)
    return np.asarray(amplitude * total / np.max(np.abs(total)) * np.minimum(time_s / 0.5, 1.0))


def steps(time_s: FloatArray, amplitude: float, dwell_s: float, levels: FloatArray) -> FloatArray:
    """Return a staircase through the levels, each held for the dwell time; the first is zero."""
    which = np.minimum((time_s / dwell_s + 1e-9).astype(int), len(levels) - 1)
    return amplitude * np.where(which == 0, 0.0, levels[which])


def triangle(time_s: FloatArray, amplitude: float, frequency_hz: float) -> FloatArray:
    """Return a triangle wave that starts at zero."""
    return amplitude * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * frequency_hz * time_s))


KINDS = ("sine", "chirp", "multisine", "steps", "triangle")


def draw(
    rng: np.random.Generator, kind: str, time_s: FloatArray, amplitude: float, frequency_hz: float
) -> FloatArray:
    """Return a signal of a kind around a frequency; what else it needs is drawn."""
    if kind == "chirp":
        return chirp(time_s, amplitude, 0.4 * frequency_hz, 2.0 * frequency_hz)
    if kind == "multisine":
        lines = frequency_hz * np.array([0.31, 0.55, 0.83, 1.13, 1.67, 2.29])
        return multisine(time_s, amplitude, lines, rng.uniform(0, 2 * np.pi, len(lines)))
    if kind == "steps":
        dwell = 1.0 / frequency_hz
        levels = rng.choice([-1.0, -0.5, 0.5, 1.0], int(time_s[-1] / dwell) + 2)
        return steps(time_s, amplitude, dwell, levels)
    if kind == "triangle":
        return triangle(time_s, amplitude, frequency_hz)
    return sine(time_s, amplitude, frequency_hz, 0.5)
