"""What is drawn of a case: what is hidden where, from decks of kinds, and what repeats differ by."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from .forms import FORMS, OUTSIDE, OUTSIDE_SIGNALS
from .plant import FloatArray, Kind, Plant
from .plants import PLANTS

DECK = {"control": 20, "outside": 7, "pair": 5, "parameter": 3, "effect": 25}
"""Cases of each kind in sixty."""
_BLOCK = sum(DECK.values())
_TRIES = 400


@dataclass(frozen=True)
class Chosen:
    """What to hide where: ids with their sites; an id of `OUTSIDE` or `OUTSIDE_SIGNALS` where `outside`."""

    plant: Plant
    hidden: tuple[tuple[Kind, str, str], ...]
    outside: bool = False


def kind_of(seed: int, index: int) -> str:
    """Return the kind of a case, whatever other cases are made."""
    block, offset = divmod(index, _BLOCK)
    deck = [kind for kind, count in DECK.items() for _ in range(count)]
    order = np.random.default_rng([seed, 20211, block]).permutation(_BLOCK)
    return deck[int(order[offset])]


def stream_of(only: str | None) -> tuple[int, ...]:
    """Return what keeps cases of one kind alone apart from those that the mixture has under the same seed."""
    # counted from one: a zero at the end of a seed would give the mixture's own numbers
    return () if only is None else (1 + list(DECK).index(only),)


def aim_of(kind: str, rng: np.random.Generator) -> float:
    """Return the gap to aim at after recalibration, in units of one trial's noise."""
    low, high = {"pair": (0.5, 30.0), "parameter": (1.0, 30.0)}.get(kind, (0.1, 30.0))
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def strength_class(gap: float) -> str:
    """Return the class of a gap."""
    return "below 0.5" if gap < 0.5 else "0.5 to 1" if gap < 1 else "1 to 3" if gap < 3 else "3 and above"


def places(plant: Plant) -> list[tuple[Kind, str, str]]:
    """Return every (site kind, effect, site) that may be hidden in a plant."""
    sites: list[tuple[Kind, str, str]] = []
    for site in plant.sites:
        sites += [(site.kind, effect, site.name) for effect in site.effects]
    for way, table in (("input", plant.input_effects), ("output", plant.output_effects)):
        for name, effects in table.items():
            sites += [(way, effect, name) for effect in effects]  # type: ignore[misc]
    return sites


def draw_plant(rng: np.random.Generator) -> Plant:
    """Return any bench."""
    return PLANTS[rng.integers(len(PLANTS))](rng)


def choose(kind: str, rng: np.random.Generator) -> Chosen:
    """Return a bench and what to hide in it."""
    if kind in ("control", "parameter"):
        return Chosen(draw_plant(rng), ())
    if kind == "outside":
        return _choose_outside(rng)
    if kind == "pair":
        while True:
            plant = draw_plant(rng)
            there = places(plant)
            first, second = (there[index] for index in rng.choice(len(there), 2, replace=False))
            # the same physics twice, or two filters of one signal, would be one cause to anyone
            if first[1] != second[1] and first[2] != second[2]:
                return Chosen(plant, (first, second))
    wanted = list(FORMS)[rng.integers(len(FORMS))]
    for _ in range(_TRIES):
        plant = draw_plant(rng)
        fitting = [location for location in places(plant) if location[:2] == wanted]
        if fitting:
            return Chosen(plant, (fitting[rng.integers(len(fitting))],))
    raise LookupError(f"no bench takes {wanted[1]} at a {wanted[0]}")


def _choose_outside(rng: np.random.Generator) -> Chosen:
    while True:
        plant = draw_plant(rng)
        if rng.random() < 0.75:
            name = list(OUTSIDE)[rng.integers(len(OUTSIDE))]
            site = plant.sites[rng.integers(len(plant.sites))]
            # a swimming body has no stroke over which anything could repeat
            if not plant.returns:
                if name in ("shaken-base", "warming-damper"):
                    return Chosen(plant, ((site.kind, name, site.name),), outside=True)
                continue
            if not plant.states and name in ("second-mode", "flutter"):
                continue
            return Chosen(plant, ((site.kind, name, site.name),), outside=True)
        name = list(OUTSIDE_SIGNALS)[rng.integers(len(OUTSIDE_SIGNALS))]
        ways: list[tuple[Kind, str]] = [("output", output.name) for output in plant.outputs]
        if plant.states:
            ways += [("input", signal.name) for signal in plant.inputs]
        way, signal = ways[rng.integers(len(ways))]
        return Chosen(plant, ((way, name, signal),), outside=True)


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
    return [replace(channel, sd=float(f"{channel.sd * factor:.4g}")) for channel in noise]
