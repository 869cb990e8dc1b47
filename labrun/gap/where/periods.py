"""Parts of the data by phase of the cycle and by frequency."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.estimate import significant
from labrun.gap.where.difference import ConditionData, Difference, Mover
from labrun.gap.where.parts import Part, SampleLayout, plain

_FEWEST_CYCLES = 1.5
"""Cycles of a period that a trial must hold before it is one."""
_FEWEST_CYCLE_SAMPLES = 16
"""Samples of a trial in which a cycle is looked for."""
_STATED_PERIOD_FIT = 0.7
"""Part of a signal's variance that a stated period must explain before it is believed to be this signal's."""
_FOUND_PERIOD_FIT = 0.8
"""Part of the second half's variance that a period found in the data must predict from the first half."""
_OSCILLATES = 0.6
"""Part of the cycles' samples in which a site must move the way its fundamental does, for its strokes to be named."""
_FEWEST_SPECTRUM_SAMPLES = 32
"""Samples of a trial below which it has no spectrum."""
_UNEVEN_STEPS = 0.05
"""Part by which its steps may differ for it to have one."""
_AT_DRIVE = (0.7, 1.4)
"""Frequencies, in units of the drive's, that count as the drive's."""
_LAST_HARMONIC = 10.5
"""Frequencies up to this many times the drive's count as its harmonics."""
_BANDS = 5
"""Bands of frequency of trials without a cycle."""
_SLOWEST_CYCLES = 1.5
"""Cycles of the first band's end that a trial holds."""

FREQUENCY_KEYS = ("frequency_hz", "freq_hz", "f_hz", "frequency", "freq", "f")
PERIOD_KEYS = ("period_s", "period")
_HARMONICS = 3
"""Harmonics of the fundamental that describe a cycle."""


@dataclass(frozen=True)
class Cycle:
    """What repeats in a trial."""

    period_s: float

    @property
    def frequency_hz(self) -> float:
        """One over the period."""
        return 1.0 / self.period_s


def find_cycle(
    time_s: FloatArray, signals: Sequence[FloatArray], condition: Mapping[str, float | str]
) -> Cycle | None:
    """Return the cycle of one trial, or None where nothing in it repeats.

    A period stated in the condition is taken where one of the signals really has it. Else the first signal decides
    whose first half, continued as a Fourier series of three harmonics, predicts its second half.

    Parameters
    ----------
    time_s : (n,)
    signals : (n,) each
        In the order of trust: what drives the trial, then what moves.
    """
    if len(time_s) < _FEWEST_CYCLE_SAMPLES:
        return None
    duration = float(time_s[-1] - time_s[0])
    moving = [signal for signal in signals if np.ptp(signal) > 0]
    for stated in _stated(condition):
        if _FEWEST_CYCLES * stated > duration or stated < 4.0 * duration / len(time_s):
            continue
        for signal in moving:
            if _explained(time_s, signal, stated) >= _STATED_PERIOD_FIT:
                return Cycle(stated)
    for signal in moving:
        period = _period(time_s, signal)
        if period is not None:
            return Cycle(period)
    return None


def _stated(condition: Mapping[str, float | str]) -> list[float]:
    rows = []
    for key, value in condition.items():
        if isinstance(value, str) or not value > 0:
            continue
        if key in FREQUENCY_KEYS:
            rows.append(1.0 / float(value))
        elif key in PERIOD_KEYS:
            rows.append(float(value))
    return rows


def _design(time_s: FloatArray, period: float) -> FloatArray:
    angle = 2 * np.pi * time_s / period
    waves = [wave(k * angle) for k in range(1, _HARMONICS + 1) for wave in (np.sin, np.cos)]
    return np.stack([np.ones_like(time_s), *waves], axis=1)


def _series(time_s: FloatArray, signal: FloatArray, period: float) -> FloatArray:
    return np.asarray(np.linalg.lstsq(_design(time_s, period), signal, rcond=None)[0], dtype=float)


def _explained(time_s: FloatArray, signal: FloatArray, period: float) -> float:
    remainder = signal - _design(time_s, period) @ _series(time_s, signal, period)
    return 1.0 - float(np.var(remainder) / np.var(signal))


def _period(time_s: FloatArray, signal: FloatArray) -> float | None:
    from scipy.optimize import minimize_scalar

    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    values = np.interp(even, time_s, signal)
    padded = 4 * len(even)
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)), padded)) ** 2
    frequency = np.fft.rfftfreq(padded, even[1] - even[0])
    duration = float(even[-1] - even[0])
    possible = (frequency >= _FEWEST_CYCLES / duration) & (frequency <= 0.25 / (even[1] - even[0]))
    if not np.any(possible) or power.max() <= 0:
        return None
    top = float(frequency[possible][np.argmax(power[possible])])
    reach = 0.5 / duration
    best = minimize_scalar(
        lambda f: -_explained(even, values, 1.0 / f),
        bounds=(max(top - reach, 0.5 * top), top + reach),
        method="bounded",
    )
    period = float(1.0 / best.x)
    half = len(even) // 2
    predicted = _design(even[half:], period) @ _series(even[:half], values[:half], period)
    error = float(np.mean(np.square(values[half:] - predicted)))
    return period if error <= (1 - _FOUND_PERIOD_FIT) * float(np.var(values[half:])) else None


def piece_cycles(
    difference: Difference, layout: SampleLayout, sites: Sequence[Mover], inputs: Sequence[Mover]
) -> tuple[Cycle | None, ...]:
    """Return the cycle of every piece: of what drives it, else of what moves, else of its outputs."""
    rows = []
    for index, piece in enumerate(layout.pieces):
        signals = [mover.coordinate[index] for mover in (*inputs, *sites)]
        outputs = piece.first(difference.simulated)
        signals += [outputs[:, column] for column in range(layout.channels)]
        rows.append(find_cycle(piece.time_s, signals, piece.trial.condition))
    return tuple(rows)


def stroke_parts(layout: SampleLayout, cycles: Sequence[Cycle | None], movers: Sequence[Mover]) -> list[Part]:
    """Return the strokes of the first site that moves, or of the first input; none where trials are not periodic.

    The stroke in which a site's coordinate rises is its forward stroke, the other one its recovery stroke.
    """
    if not movers or any(cycle is None for cycle in cycles):
        return []
    mover = movers[0]
    rises = [np.asarray(rate > 0) for rate in mover.rate]
    share = float(np.mean(np.concatenate(rises)))
    if not 1 - _OSCILLATES < share < _OSCILLATES + 0.2:
        return []
    name = plain(mover.name)
    members = layout.samples(rises)
    if mover.kind == "input":
        names = (f"rising {mover.name}", f"falling {mover.name}")
        texts = (
            f"the half of the cycle in which {name} rises",
            f"the half of the cycle in which {name} falls",
        )
    else:
        names = ("forward stroke", "recovery stroke")
        texts = (f"the forward stroke ({name} rises)", f"the recovery stroke ({name} falls)")
    return [Part("phase", names[0], texts[0], members), Part("phase", names[1], texts[1], ~members)]


@dataclass(frozen=True)
class Spectra:
    """Periodograms of every piece, tapered (Hann), scaled so that they add up to the sum of squares over the samples.

    Pieces that are too short or unevenly sampled have none.
    """

    layout: SampleLayout

    @property
    def possible(self) -> tuple[ConditionData, ...]:
        """The pieces that have a spectrum."""
        return tuple(piece for piece in self.layout.pieces if _even(piece))

    def power(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the power of every piece's (n, m), (frequencies, m) flat, one after the other."""
        rows = []
        for piece, value in zip(self.layout.pieces, values, strict=True):
            if not _even(piece):
                continue
            taper = np.hanning(piece.length + 2)[1:-1]
            taper = taper / np.sqrt(np.mean(taper**2))
            power = np.square(np.abs(np.fft.rfft(value * taper[:, None], axis=0))) / piece.length
            power[1 : (piece.length + 1) // 2] *= 2.0
            rows.append(power.ravel())
        return np.concatenate(rows) if rows else np.empty(0)

    def frequency_hz(self, piece: ConditionData) -> FloatArray:
        """Return the frequencies of a piece's spectrum."""
        step = float(piece.time_s[-1] - piece.time_s[0]) / (piece.length - 1)
        return np.asarray(np.fft.rfftfreq(piece.length, step), dtype=float)


def _even(piece: ConditionData) -> bool:
    if piece.length < _FEWEST_SPECTRUM_SAMPLES:
        return False
    steps = np.diff(piece.time_s)
    return bool(np.max(np.abs(steps - steps.mean())) <= _UNEVEN_STEPS * steps.mean())


def band_parts(
    spectra: Spectra, cycles: Sequence[Cycle | None], simulated: Sequence[FloatArray], *, driven: bool
) -> list[Part]:
    """Return bands: about the drive where every trial has one, else octaves about what the data hold.

    Parameters
    ----------
    simulated : per piece (n, m)
    driven
        Whether anything drives the trials; what swings by itself has its own frequency.
    """
    pieces = spectra.possible
    if not pieces:
        return []
    even_cycles = [cycle for piece, cycle in zip(spectra.layout.pieces, cycles, strict=True) if _even(piece)]
    drives = [cycle.frequency_hz for cycle in even_cycles if cycle is not None]
    if len(drives) == len(pieces):
        return _about_drive(spectra, drives, "drive" if driven else "oscillation")
    return _absolute(spectra, simulated)


def _about_drive(spectra: Spectra, drives: Sequence[float], what: str) -> list[Part]:
    low, high = min(drives), max(drives)
    drive = _hz(low) if high < 1.01 * low else f"{_span(low, high)}"
    bands = (
        ("below the drive", f"frequencies below the {what}'s ({drive})", 0.0, _AT_DRIVE[0]),
        ("at the drive", f"the {what}'s frequency ({drive})", *_AT_DRIVE),
        ("harmonics", f"the harmonics of the {what} ({drive})", _AT_DRIVE[1], _LAST_HARMONIC),
        ("above", f"frequencies above the {what}'s tenth harmonic ({drive})", _LAST_HARMONIC, np.inf),
    )
    parts = []
    for at, text, begin, end in bands:
        masks = [
            _mask(spectra, piece, begin * drive_hz, end * drive_hz)
            for piece, drive_hz in zip(spectra.possible, drives, strict=True)
        ]
        parts.append(Part("frequency", at, text, np.concatenate(masks), "frequency"))
    return parts


def _absolute(spectra: Spectra, simulated: Sequence[FloatArray]) -> list[Part]:
    pieces = spectra.possible
    duration = max(float(piece.time_s[-1] - piece.time_s[0]) for piece in pieces)
    nyquist = max(float(spectra.frequency_hz(piece)[-1]) for piece in pieces)
    deviation = np.std(np.concatenate(simulated), axis=0)
    moving = np.where(deviation > 0, deviation, 1.0)
    power = spectra.power([(outputs - outputs.mean(axis=0)) / moving for outputs in simulated])
    frequency = np.concatenate(
        [np.repeat(spectra.frequency_hz(piece), spectra.layout.channels) for piece in pieces]
    )
    order = np.argsort(frequency)
    total = np.cumsum(power[order])
    reach = frequency[order][np.searchsorted(total, 0.99 * total[-1])] if total[-1] > 0 else 0.1 * nyquist
    lowest = _SLOWEST_CYCLES / duration
    highest = min(max(3.0 * float(reach), 8.0 * lowest), 0.9 * nyquist)
    if highest <= lowest:
        return []
    inner = np.geomspace(lowest, highest, _BANDS - 1)
    edges = [0.0, *inner, np.inf]
    parts = []
    for begin, end in pairwise(edges):
        text = (
            f"below {_hz(end)}"
            if begin == 0
            else f"above {_hz(begin)}"
            if np.isinf(end)
            else _span(begin, end)
        )
        masks = [_mask(spectra, piece, begin, end) for piece in pieces]
        parts.append(
            Part(
                "frequency",
                text,
                f"frequencies {'of ' * text[0].isdigit()}{text}",
                np.concatenate(masks),
                "frequency",
            )
        )
    return parts


def _mask(spectra: Spectra, piece: ConditionData, begin: float, end: float) -> NDArray[np.bool_]:
    frequency = spectra.frequency_hz(piece)
    return np.repeat((frequency >= begin) & (frequency < end), spectra.layout.channels)


def _hz(value: float) -> str:
    return f"{significant(value)} Hz"


def _span(low: float, high: float) -> str:
    return f"{significant(low)} to {significant(high)} Hz"
