"""Parts of the data by frequency."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labrun.gap.verdict import significant
from labrun.gap.where.cycle import Cycle
from labrun.gap.where.parts import Layout, Part
from labrun.gap.where.pooling import Piece

FloatArray = NDArray[np.float64]

_FEWEST_SAMPLES = 32
_UNEVEN = 0.05
_AT_DRIVE = (0.7, 1.4)
_HARMONICS = 10.5
_BANDS = 5
_SLOWEST_CYCLES = 1.5


@dataclass(frozen=True)
class Spectra:
    """Periodograms of every piece, tapered (Hann), scaled so that they add up to the sum of squares over the samples.

    Pieces that are too short or unevenly sampled have none.
    """

    layout: Layout

    @property
    def possible(self) -> tuple[Piece, ...]:
        """The pieces that have a spectrum."""
        return tuple(piece for piece in self.layout.pieces if _even(piece))

    def power(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the power of every piece's (n, m), (frequencies, m) flat, one after the other."""
        found = []
        for piece, one in zip(self.layout.pieces, values, strict=True):
            if not _even(piece):
                continue
            taper = np.hanning(piece.length + 2)[1:-1]
            taper = taper / np.sqrt(np.mean(taper**2))
            power = np.square(np.abs(np.fft.rfft(one * taper[:, None], axis=0))) / piece.length
            power[1 : (piece.length + 1) // 2] *= 2.0
            found.append(power.ravel())
        return np.concatenate(found) if found else np.empty(0)

    def frequency_hz(self, piece: Piece) -> FloatArray:
        """Return the frequencies of a piece's spectrum."""
        step = float(piece.time_s[-1] - piece.time_s[0]) / (piece.length - 1)
        return np.asarray(np.fft.rfftfreq(piece.length, step), dtype=float)


def _even(piece: Piece) -> bool:
    if piece.length < _FEWEST_SAMPLES:
        return False
    steps = np.diff(piece.time_s)
    return bool(np.max(np.abs(steps - steps.mean())) <= _UNEVEN * steps.mean())


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
    found = [cycle for piece, cycle in zip(spectra.layout.pieces, cycles, strict=True) if _even(piece)]
    drives = [cycle.frequency_hz for cycle in found if cycle is not None]
    if len(drives) == len(pieces):
        return _about_drive(spectra, drives, "drive" if driven else "oscillation")
    return _absolute(spectra, simulated)


def _about_drive(spectra: Spectra, drives: Sequence[float], what: str) -> list[Part]:
    low, high = min(drives), max(drives)
    drive = _hz(low) if high < 1.01 * low else f"{_span(low, high)}"
    bands = (
        ("below the drive", f"frequencies below the {what}'s ({drive})", 0.0, _AT_DRIVE[0]),
        ("at the drive", f"the {what}'s frequency ({drive})", *_AT_DRIVE),
        ("harmonics", f"the harmonics of the {what} ({drive})", _AT_DRIVE[1], _HARMONICS),
        ("above", f"frequencies above the {what}'s tenth harmonic ({drive})", _HARMONICS, np.inf),
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
    power = spectra.power([(one - one.mean(axis=0)) / moving for one in simulated])
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


def _mask(spectra: Spectra, piece: Piece, begin: float, end: float) -> NDArray[np.bool_]:
    frequency = spectra.frequency_hz(piece)
    return np.repeat((frequency >= begin) & (frequency < end), spectra.layout.channels)


def _hz(value: float) -> str:
    return f"{significant(value)} Hz"


def _span(low: float, high: float) -> str:
    return f"{significant(low)} to {significant(high)} Hz"
