"""What repeats differ by: sensor noise of several colours, encoder counts, creeping zeros, trial-to-trial scatter."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from .plant import FloatArray

Colour = Literal["white", "ar1", "counts", "pink"]
COLOURS: dict[Colour, float] = {"white": 0.35, "ar1": 0.3, "counts": 0.2, "pink": 0.15}
"""Colours and how often each is drawn; "pink" has as much power in every octave (1/f)."""


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one output.

    Attributes
    ----------
    sd
        Standard deviation of what the sensor adds, in the output's unit.
    correlation
        Of successive samples, for "ar1".
    creep_share
        Peak of a trial's own creep of the zero, in units of `sd`.
    zero
        Standard deviation of a trial's own zero, as of an encoder that is set anew each time, in units of `sd`.
    """

    colour: Colour
    sd: float
    correlation: float
    creep_share: float
    zero: float = 0.0

    def apply(self, signal: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the measured signal (samples,)."""
        samples = len(signal)
        creep = self.creep_share * self.sd * rng.uniform(-1, 1) * np.linspace(-0.5, 0.5, samples)
        fresh = rng.standard_normal(samples)
        if self.zero:
            creep = creep + self.zero * self.sd * rng.standard_normal()
        if self.colour == "pink":
            return np.asarray(signal + creep + self.sd * _pink(fresh))
        if self.colour == "counts":
            # a count of sqrt(12) * 0.9 sd alone has 0.9 of the noise; a little white noise makes up the rest
            count = np.sqrt(12.0) * 0.9 * self.sd
            noisy = signal + creep + 0.436 * self.sd * fresh
            return np.asarray(np.round(noisy / count) * count)
        if self.colour == "ar1":
            r = self.correlation
            start = r * rng.standard_normal()
            drive = np.sqrt(1.0 - r * r)
            coloured, _ = lfilter([drive], [1.0, -r], fresh, zi=np.array([start]))
            return np.asarray(signal + creep + self.sd * coloured)
        return np.asarray(signal + creep + self.sd * fresh)


def _pink(white: FloatArray) -> FloatArray:
    """Return noise of variance 1 with a spectrum that falls with the frequency."""
    spectrum = np.fft.rfft(white)
    places = np.arange(1, len(spectrum))
    shape = np.concatenate([[0.0], 1.0 / np.sqrt(places)])
    scale = np.sqrt(len(white) / (2.0 * np.sum(np.square(shape))))
    return np.asarray(np.fft.irfft(spectrum * shape * scale, n=len(white)))


def draw_noise(
    rng: np.random.Generator, sizes: FloatArray, colour: Colour | None = None
) -> list[ChannelNoise]:
    """Return noise of one kind for all outputs, `sizes` its standard deviations before they are scaled."""
    drawn: Colour = str(rng.choice(list(COLOURS), p=list(COLOURS.values())))  # type: ignore[assignment]
    colour = colour or drawn
    correlation = float(rng.uniform(0.5, 0.93)) if colour == "ar1" else 0.0
    creep = float(rng.uniform(0.0, 0.5)) if rng.random() < 0.4 else 0.0
    return [
        ChannelNoise(colour, float(size * rng.uniform(0.8, 1.25)), round(correlation, 3), round(creep, 3))
        for size in sizes
    ]


def rescaled(noise: list[ChannelNoise], factor: float) -> list[ChannelNoise]:
    """Return the noise of all channels larger by a factor, to four digits."""
    return [replace(one, sd=float(f"{one.sd * factor:.4g}")) for one in noise]
