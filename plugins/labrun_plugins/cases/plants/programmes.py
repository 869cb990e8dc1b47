"""What a bench is commanded: test signals, time bases, excitations by amplitude and frequency, releases."""

import numpy as np

from ..plant import Condition, FloatArray, Programme


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


_BASES = (
    (6.0, 100),
    (6.0, 160),
    (8.0, 100),
    (8.0, 120),
    (10.0, 100),
    (12.0, 80),
    (15.0, 50),
    (20.0, 50),
    (6.0, 200),
)


def time_base(rng: np.random.Generator) -> FloatArray:
    """Return sample times of one of several usual lengths and rates."""
    length_s, rate_hz = _BASES[rng.integers(len(_BASES))]
    return np.arange(round(length_s * rate_hz) + 1) / rate_hz


def driven(
    rng: np.random.Generator,
    trials: int,
    time_s: FloatArray,
    peaks: list[float],
    natural_hz: float,
    kinds: tuple[str, ...] = KINDS,
) -> Programme:
    """Return amplitudes times frequencies of one kind of signal, or a mixture of kinds, below and above resonance.

    `peaks`: the largest amplitude of each input. `kinds`: which signals to choose from.
    """
    mixed = rng.random() < 0.4
    kind = str(rng.choice(kinds))
    slowest = max(0.15, 1.5 / time_s[-1])
    frequencies = np.geomspace(max(0.25 * natural_hz, slowest), 1.3 * natural_hz, 4)
    shares = np.array([0.35, 0.6, 1.0])
    cells = [(share, frequency) for share in shares for frequency in frequencies]
    order = rng.permutation(len(cells))
    conditions: list[Condition] = []
    inputs = np.zeros((len(peaks), len(time_s), trials))
    for index in range(trials):
        share, frequency = cells[order[index % len(cells)]]
        # a second round through the cells, for programmes longer than they are, is between the first
        round_number = index // len(cells)
        share, frequency = share * 0.87**round_number, round(float(frequency * 1.13**round_number), 3)
        this = kinds[rng.integers(len(kinds))] if mixed else kind
        # on resonance the same drive moves a bench several times as far
        gentle = 0.4 + 0.6 * min(abs(np.log(frequency / natural_hz)), 1.0)
        condition: Condition = {"frequency_hz": frequency, "signal": this}
        for row, peak in enumerate(peaks):
            amplitude = float(f"{peak * share * gentle:.4g}")
            own = frequency if row == 0 else frequency * 1.37
            inputs[row, :, index] = draw(rng, this, time_s, amplitude * (1 if row == 0 else 0.7), own)
            condition["amplitude" if row == 0 else f"amplitude_{row + 1}"] = amplitude
        conditions.append(condition)
    return Programme(time_s, conditions, round_inputs(inputs))


def round_inputs(inputs: FloatArray) -> FloatArray:
    """Return inputs as they will stand in the file, so that the truth is driven by just these."""
    digits = 7 - np.ceil(np.log10(np.maximum(np.max(np.abs(inputs), axis=(1, 2), keepdims=True), 1e-12)))
    scale = 10.0**digits
    rounded: FloatArray = np.round(inputs * scale) / scale
    return rounded


def releases(
    rng: np.random.Generator, trials: int, time_s: FloatArray, low_deg: float, high_deg: float
) -> Programme:
    """Return releases from different angles to both sides, with no input."""
    angles = np.linspace(low_deg, high_deg, trials) * rng.choice([-1.0, 1.0], trials)
    if np.all(angles > 0) or np.all(angles < 0):
        angles[::2] *= -1
    conditions: list[Condition] = [
        {"release_deg": float(np.round(angle, 2)), "release_rad": float(np.round(np.deg2rad(angle), 5))}
        for angle in rng.permutation(angles)
    ]
    return Programme(time_s, conditions, np.zeros((0, len(time_s), trials)))
