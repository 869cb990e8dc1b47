"""One design: a controller for a plant, with everything that is predicted of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.closed_loop import (
    StepFigures,
    Track,
    horizon_s,
    run_loop,
    steady_error,
    step_figures,
)
from labrun.fit.tuning.controller import Gains
from labrun.fit.tuning.loop import Loop
from labrun.fit.tuning.margins import Margins, margins

FloatArray = NDArray[np.float64]

_LONGEST = 8.0
"""A step is followed at most so many times as long as delays and lags ask for: a weak integral creeps for ever."""
_STEPS = 20000
_TRACK_STEPS = 8000
_PER_LAG = 40.0
"""A reference is followed in at most so many steps, unless lags and delays ask for more: so many over them."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Margins over plants that the data do not tell apart from the fitted one.

    Attributes
    ----------
    gain, phase_deg
        95 % intervals.
    unstable_share
        Share of the plants on which the loop is unstable.
    plants
        How many there were.
    """

    gain: tuple[float, float]
    phase_deg: tuple[float, float]
    unstable_share: float
    plants: int


@dataclass(frozen=True)
class Design:
    """A controller in its loop.

    Attributes
    ----------
    name
        Short, and good as the key of a controller table: ``pi-optimum``.
    source
        ``"simc"``, ``"optimum"``, or ``"given"`` for gains that somebody wrote down.
    """

    name: str
    source: str
    gains: Gains
    loop: Loop

    @cached_property
    def margins(self) -> Margins:
        """Margins of the loop as it runs."""
        return margins(self.gains, self.loop)

    @property
    def structure(self) -> str:
        """Kind of controller: ``FF-PI``."""
        gains = self.gains
        letters = "P" * bool(gains.p) + "I" * bool(gains.i_per_s) + "D" * bool(gains.d_s)
        return "-".join(part for part in ("FF" if gains.feedforward is not None else "", letters) if part)

    @cached_property
    def step(self) -> Track:
        """A step of the reference by 1, on a drive without bounds; of an unstable loop only its beginning."""
        longest = _LONGEST * horizon_s(self.loop)
        lasts_s = min(horizon_s(self.loop, self.gains), longest, _STEPS * self.loop.step_s)
        if not self.margins.stable:
            lasts_s = horizon_s(self.loop)
        return run_loop(self.gains, self.loop, lambda _: 1.0, lasts_s)

    @property
    def steady_error(self) -> float:
        """What is left of a constant reference, relative to it."""
        return steady_error(self.gains, self.loop.gain)

    @cached_property
    def figures(self) -> StepFigures:
        """What the step leads to."""
        return step_figures(self.step, self.steady_error)

    @cached_property
    def noise_gain(self) -> float:
        """Standard deviation of the drive per that of white noise on the feedback's samples."""
        count = 1024
        omega = (np.arange(count) + 0.5) * np.pi / count / self.loop.step_s
        through = self.gains.frequency_response(omega, self.loop.step_s)
        closed = through / (1.0 + through * self.loop.frequency_response(omega))
        return float(np.sqrt(np.mean(np.abs(closed) ** 2)))

    def over(self, loops: Sequence[Loop]) -> Spread:
        """Return how the margins vary over loops around other plants."""
        found = [margins(self.gains, loop, refine=False) for loop in loops]
        gain = np.array([one.gain if one.stable else min(one.gain, 1.0) for one in found])
        phase = np.array([one.phase_deg if one.stable else 0.0 for one in found])
        return Spread(
            _interval(gain), _interval(phase), float(np.mean([not one.stable for one in found])), len(found)
        )

    def errors(
        self,
        reference: "HalfSine",
        bounds: tuple[float, float],
        factors: Sequence[float],
    ) -> dict[float, tuple[float, float]]:
        """Return the mean magnitude of the error over the first and the second arch of a reference.

        Parameters
        ----------
        bounds
            Range of the drive, which starts at the end nearest to zero.
        factors
            The plant's gain over the one that the controller was made for.
        """
        found = {}
        for factor in factors:
            track = self.follow(reference, bounds, factor)
            size = np.abs(track.reference - track.output)
            half = len(size) // 2
            found[factor] = (float(np.mean(size[:half])), float(np.mean(size[half:])))
        return found

    def follow(self, reference: "HalfSine", bounds: tuple[float, float], factor: float = 1.0) -> Track:
        """Run two arches of a reference, on a plant of `factor` times the gain."""
        start = float(min(max(0.0, bounds[0]), bounds[1]))
        lasting_s = self.loop.delay_s + float(np.sum(self.loop.lags_s))
        enough_hz = max(_TRACK_STEPS / (2.0 * reference.period_s), _PER_LAG / lasting_s)
        rate_hz = min(self.loop.rate_hz or enough_hz, enough_hz)
        plant = scaled_plant(self.loop.plant, factor)
        return run_loop(
            self.gains,
            replace(self.loop, plant=plant, rate_hz=rate_hz),
            reference,
            2.0 * reference.period_s,
            bounds=bounds,
            start=start,
        )


@dataclass(frozen=True, slots=True)
class HalfSine:
    """``low + (high - low) |sin(pi t / period_s)|``, the reference of section 5.4 of the source."""

    low: float
    high: float
    period_s: float

    def __call__(self, time_s: float) -> float:
        """Return the value at a time."""
        return self.low + (self.high - self.low) * abs(float(np.sin(np.pi * time_s / self.period_s)))


def scaled_plant(plant: TransferFunction, factor: float) -> TransferFunction:
    """Return a plant of `factor` times the gain."""
    return replace(plant, numerator=tuple(factor * value for value in plant.numerator))


def as_json(design: Design, rate_hz: float) -> Mapping[str, object]:
    """Return a design's numbers, JSON-ready; None for what is infinite."""
    gains, found, figures = design.gains, design.margins, design.figures
    numbers: dict[str, float] = {
        "p": gains.p,
        "i_per_s": gains.i_per_s,
        "i_per_sample": gains.i_per_sample(rate_hz),
        "d_s": gains.d_s,
        "filter_s": gains.filter_s,
        "gain_margin": found.gain,
        "phase_margin_deg": found.phase_deg,
        "delay_margin_s": found.delay_s,
        "max_sensitivity": found.sensitivity,
        "crossover_rad_s": found.crossover_rad_s,
        "phase_crossover_rad_s": found.phase_crossover_rad_s,
        "overshoot": figures.overshoot,
        "settling_s": figures.settling_s,
        "steady_error": figures.steady_error,
        "peak_drive": figures.peak_drive,
        "noise_gain": design.noise_gain,
    }
    return {
        "structure": design.structure,
        "source": design.source,
        "stable": found.stable,
        "feedforward": gains.feedforward,
        **{name: float(value) if np.isfinite(value) else None for name, value in numbers.items()},
    }


def _interval(values: FloatArray) -> tuple[float, float]:
    # infinite margins are margins: order statistics, no interpolation between a number and inf
    low, high = np.percentile(values, [2.5, 97.5], method="nearest")
    return float(low), float(high)
