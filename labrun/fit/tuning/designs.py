"""Controllers designed for a plant: what is predicted of each, on plants like it, too, and which one to take."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import tomli_w

from labrun.arrays import FloatArray
from labrun.control import HalfSineReference, HalfSineSettings
from labrun.errors import FitError
from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.loop import Gains, Margins, OpenLoop, horizon_s, margins
from labrun.fit.tuning.optimum import keeps, loop_error, optimum, require_stable
from labrun.fit.tuning.response import UNBOUNDED, LoopResponse, StepFigures, run_loop, step_figures
from labrun.fit.tuning.settings import GivenTable, PidFitSettings
from labrun.fit.tuning.simc import Structure, simc

_LONGEST = 8.0
"""A step is followed at most so many times as long as delays and lags ask for: a weak integral creeps for ever."""
_STEPS = 20000
_TRACK_STEPS = 8000
_PER_LAG = 40.0
"""A reference is followed in at most so many steps, unless lags and delays ask for more: so many over them."""
_DEFAULT_FILTER_STEPS = 2.0
"""Time constant of the derivative's filter in steps, where a controller names none: as of the controller plugin."""
_DIGITS = 5


@dataclass(frozen=True, slots=True)
class Spread:
    """Margins over plants that the data do not tell apart from the fitted one.

    Attributes
    ----------
    gain, phase_deg
        95 % intervals.
    unstable_share
        Share of the plants on which the loop is unstable.
    """

    gain: tuple[float, float]
    phase_deg: tuple[float, float]
    unstable_share: float
    plants: int


@dataclass(frozen=True)
class ControllerDesign:
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
    loop: OpenLoop

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
    def step(self) -> LoopResponse:
        """A step of the reference by 1, on a drive without bounds; of an unstable loop only its beginning."""
        lasts_s = horizon_s(self.loop)
        if self.margins.stable:
            lasts_s = min(horizon_s(self.loop, self.gains), _LONGEST * lasts_s, _STEPS * self.loop.step_s)
        return run_loop(self.gains, self.loop, lambda _: 1.0, lasts_s)

    @property
    def steady_error(self) -> float:
        """What is left of a constant reference, relative to it."""
        return self.gains.steady_error(self.loop.gain)

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

    def over(self, loops: Sequence[OpenLoop]) -> Spread:
        """Return how the margins vary over loops around other plants."""
        loop_margins = [margins(self.gains, loop) for loop in loops]
        gain = np.array([m.gain if m.stable else min(m.gain, 1.0) for m in loop_margins])
        phase = np.array([m.phase_deg if m.stable else 0.0 for m in loop_margins])
        unstable = float(np.mean([not m.stable for m in loop_margins]))
        return Spread(_interval(gain), _interval(phase), unstable, len(loop_margins))

    def errors(
        self, reference: HalfSineSettings, bounds: tuple[float, float], factors: Sequence[float]
    ) -> dict[float, tuple[float, float]]:
        """Return the mean magnitude of the error over the first and the second arch of a reference.

        `factors`: the plant's gain over the one that the controller was made for; the errors are by them.
        """
        errors = {}
        for factor in factors:
            track = self.follow(reference, bounds, factor)
            first, second = np.split(np.abs(track.reference - track.output), [len(track.time_s) // 2])
            errors[factor] = (float(np.mean(first)), float(np.mean(second)))
        return errors

    def follow(
        self, reference: HalfSineSettings, bounds: tuple[float, float], factor: float = 1.0
    ) -> LoopResponse:
        """Run two arches of a reference, on a plant of `factor` times the gain.

        The drive starts at the end of its range, `bounds`, that is nearest to zero.
        """
        start = float(min(max(0.0, bounds[0]), bounds[1]))
        lasting_s = self.loop.delay_s + float(np.sum(self.loop.lags_s))
        enough_hz = max(_TRACK_STEPS / (2.0 * reference.period_s), _PER_LAG / lasting_s)
        plant = self.loop.plant
        plant = replace(plant, numerator=tuple(factor * value for value in plant.numerator))
        loop = replace(self.loop, plant=plant, rate_hz=min(self.loop.rate_hz or enough_hz, enough_hz))
        course = HalfSineReference(reference.model_dump(), {})
        return run_loop(self.gains, loop, course, 2.0 * reference.period_s, bounds=bounds, start=start)


def as_json(design: ControllerDesign, rate_hz: float) -> Mapping[str, object]:
    """Return a design's numbers, JSON-ready; None for what is infinite."""
    gains, design_margins, figures = design.gains, design.margins, design.figures
    numbers = {
        "p": gains.p, "i_per_s": gains.i_per_s, "i_per_sample": gains.i_per_sample(rate_hz), "d_s": gains.d_s,
        "filter_s": gains.filter_s, "gain_margin": design_margins.gain, "phase_margin_deg": design_margins.phase_deg,
        "delay_margin_s": design_margins.delay_s, "max_sensitivity": design_margins.sensitivity,
        "crossover_rad_s": design_margins.crossover_rad_s,
        "phase_crossover_rad_s": design_margins.phase_crossover_rad_s,
        **asdict(figures), "noise_gain": design.noise_gain,
    }  # fmt: skip
    return {
        "structure": design.structure,
        "source": design.source,
        "stable": design_margins.stable,
        "feedforward": gains.feedforward,
        **{name: float(value) if np.isfinite(value) else None for name, value in numbers.items()},
    }


def _interval(values: FloatArray) -> tuple[float, float]:
    # infinite margins are margins: order statistics, no interpolation between a number and inf
    low, high = np.percentile(values, [2.5, 97.5], method="nearest")
    return float(low), float(high)


def design_all(loop: OpenLoop, settings: PidFitSettings) -> tuple[list[ControllerDesign], list[str]]:
    """Return the designs, those that were given last, and what to know about them.

    Raises FitError: the plant does not settle, or no design could be made.
    """
    require_stable(loop)
    designs: list[ControllerDesign] = []
    warnings: list[str] = []
    for structure, rule in product(settings.structures, settings.rules):
        try:
            designs += _of(loop, settings, structure, rule)
        except FitError as error:
            warnings.append(f"no {structure} by {rule}: {error.args[0]}")
    if not designs and warnings:
        raise FitError("\n".join(warnings), hint='try method = "optimum", or smaller margins')
    designs.sort(key=lambda design: design.gains.feedforward is not None)
    return designs + given(loop, settings.compare, settings.lead_s), warnings


def given(loop: OpenLoop, tables: Mapping[str, GivenTable], lead_s: float) -> list[ControllerDesign]:
    """Return gains that were written down as designs."""
    designs = []
    for name, keys in tables.items():
        per_s = keys.i * (1.0 if keys.i_per == "second" else 1.0 / loop.step_s)
        filter_s = _DEFAULT_FILTER_STEPS * loop.step_s if keys.filter_s is None else keys.filter_s
        ahead = (1.0 / loop.gain, lead_s) if keys.feedforward else (None, 0.0)
        designs.append(ControllerDesign(name, "given", Gains(keys.p, per_s, keys.d, filter_s, *ahead), loop))
    return designs


def _of(loop: OpenLoop, settings: PidFitSettings, structure: Structure, rule: str) -> list[ControllerDesign]:
    name = f"{structure.lower()}-{rule}"
    ahead = {"feedforward": 1.0 / loop.gain, "lead_s": settings.lead_s}
    if rule == "simc":
        gains = simc(loop, structure, tau_c_s=settings.tau_c_s, derivative_filter=settings.derivative_filter)
    else:
        gains = optimum(loop, structure, settings)
    made = [ControllerDesign(name, rule, gains, loop)]
    # a derivative beside a feed-forward is not asked for: what it would hasten, the feed-forward does
    if settings.feedforward and structure != "PID":
        helped = (
            replace(gains, **ahead)
            if rule == "simc"
            else optimum(loop, structure, settings, **ahead, gain_error=settings.gain_error)
        )
        made.append(ControllerDesign(f"ff-{name}", rule, helped, loop))
    return made


def controllers_toml(
    designs: Sequence[ControllerDesign], best: str | None, i_per: str, loop_name: str, heading: str
) -> str:
    """Return tables ``[track.loops.NAME.controllers.DESIGN]``, ready to be pasted; the `best` comes first.

    Designs only: what was given stands in an experiment already, and what is unstable should stand in none.
    """
    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    stable = [design for design in designs if design.margins.stable and design.source != "given"]
    for design in sorted(stable, key=lambda candidate: candidate.name != best):
        design_margins = design.margins
        phase = (
            f"phase margin {design_margins.phase_deg:.0f} deg"
            if design_margins.phase_deg < 1e3
            else "loop gain below 1"
        )
        head = "recommended: " if design.name == best else ""
        lines += ["", f"# {head}{design.structure}, gain margin {design_margins.gain:.2f}, {phase}"]
        nested = {"controllers": {design.name: controller_table(design, i_per)}}
        lines.append(tomli_w.dumps({"track": {"loops": {loop_name: nested}}}).rstrip())
    return "\n".join(lines) + "\n"


def controller_table(design: ControllerDesign, i_per: str) -> dict[str, Any]:
    """Return the keys of a design's controller table."""
    gains = design.gains
    table = design.loop.plant.to_table()
    model = {key: value for key, value in table.items() if not key.endswith(("_name", "_unit"))}
    keys = gains.settings(design.loop.step_s, i_per, model)
    return {"plugin": gains.plugin, **{key: _rounded(value) for key, value in keys.items()}}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(number) for key, number in value.items()}
    if isinstance(value, list):
        return [_rounded(number) for number in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, int | float) else value


_NEARLY = 1.2
"""Designs whose error is within this of the least are as good: then the drive's noise decides."""
_LOST_SHARE = 0.025
"""Share of plants on which a loop may be unstable before its margin counts as lost in the 95 % interval."""

MOST_OVERSHOOT = 0.25
"""Of a step: a design above it is for slow references only, and not taken where no reference is known."""

Errors = Mapping[float, tuple[float, float]]


@dataclass(frozen=True)
class Study:
    """What came out.

    Attributes
    ----------
    loop
        Around the fitted plant.
    designs
        Those that were given last.
    spreads
        By design; empty where there are no resampled plants.
    errors
        By design: mean magnitude of the tracking error over the first and the second arch, by factor of the plant's
        gain; empty without a reference. Of stable loops only.
    best
        Name of the design to take; None if none keeps its margins, or if each that does overshoots a step by more
        than `MOST_OVERSHOOT` and there is no slower reference that it would have to follow instead.
    scores
        By design: the error that decides.
    warnings
        Of designs that could not be made.
    """

    settings: PidFitSettings
    loop: OpenLoop
    designs: tuple[ControllerDesign, ...]
    spreads: Mapping[str, Spread]
    errors: Mapping[str, Errors]
    scores: Mapping[str, float]
    best: str | None
    warnings: tuple[str, ...]

    def named(self, name: str) -> ControllerDesign:
        """Return a design."""
        return next(design for design in self.designs if design.name == name)


def study(
    plant: TransferFunction, plants: Sequence[TransferFunction], settings: PidFitSettings, average_s: float
) -> Study:
    """Design and judge.

    `plant`, `plants`: the fitted one, and those that the data do not tell apart from it. `average_s`: over which the
    feedback is a mean; 0 for none. Raises FitError: the plant does not settle, or no design could be made.
    """
    loop = OpenLoop(plant, settings.rate_hz, settings.compute_s, average_s)
    designs, warnings = design_all(loop, settings)
    around = [replace(loop, plant=transfer) for transfer in plants]
    spreads = {design.name: design.over(around) for design in designs} if around else {}
    stable = [design for design in designs if design.margins.stable]
    reference, off, errors, scores = settings.reference, settings.gain_error, dict[str, Errors](), {}
    factors = (1.0 - off, 1.0, 1.0 + off) if off else (1.0,)
    for design in stable:
        if reference is None:
            scores[design.name] = loop_error(loop, design.gains, settings)
        else:
            errors[design.name] = design.errors(reference, settings.range or UNBOUNDED, factors)
            scores[design.name] = max(
                0.5 * (first + second) for first, second in errors[design.name].values()
            )
    best = _best(stable, spreads, scores, settings)
    return Study(settings, loop, tuple(designs), spreads, errors, scores, best, tuple(warnings))


def lost(spread: Spread) -> bool:
    """Tell whether a loop may be unstable on a plant within the fit's 95 % interval."""
    return spread.unstable_share > _LOST_SHARE or spread.gain[0] <= 1.0


def _best(
    stable: Sequence[ControllerDesign],
    spreads: Mapping[str, Spread],
    scores: Mapping[str, float],
    settings: PidFitSettings,
) -> str | None:
    fit = [
        design
        for design in stable
        if design.source != "given"
        and keeps(design.gains, design.loop, settings)
        and not (design.name in spreads and lost(spreads[design.name]))
        and (settings.reference is not None or design.figures.overshoot <= MOST_OVERSHOOT)
    ]
    if not fit:
        return None
    least = min(scores[design.name] for design in fit)
    near = [design for design in fit if scores[design.name] <= _NEARLY * least]
    return min(near, key=lambda design: (design.noise_gain, scores[design.name])).name
