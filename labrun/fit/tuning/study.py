"""All designs for a plant, how each does on plants like it, and which one to take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning.designs import ControllerDesign, Spread, design_all
from labrun.fit.tuning.loop import OpenLoop
from labrun.fit.tuning.optimum import keeps, loop_error
from labrun.fit.tuning.response import UNBOUNDED
from labrun.fit.tuning.settings import PidFitSettings

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
        return next(one for one in self.designs if one.name == name)


def study(
    plant: TransferFunction, plants: Sequence[TransferFunction], settings: PidFitSettings, average_s: float
) -> Study:
    """Design and judge.

    `plant`, `plants`: the fitted one, and those that the data do not tell apart from it. `average_s`: over which the
    feedback is a mean; 0 for none. Raises FitError: the plant does not settle, or no design could be made.
    """
    loop = OpenLoop(plant, settings.rate_hz, settings.compute_s, average_s)
    designs, warnings = design_all(loop, settings)
    around = [replace(loop, plant=one) for one in plants]
    spreads = {one.name: one.over(around) for one in designs} if around else {}
    stable = [one for one in designs if one.margins.stable]
    reference, off, errors, scores = settings.reference, settings.gain_error, dict[str, Errors](), {}
    factors = (1.0 - off, 1.0, 1.0 + off) if off else (1.0,)
    for one in stable:
        if reference is None:
            scores[one.name] = loop_error(loop, one.gains, settings)
        else:
            errors[one.name] = one.errors(reference, settings.range or UNBOUNDED, factors)
            scores[one.name] = max(0.5 * (first + second) for first, second in errors[one.name].values())
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
        one
        for one in stable
        if one.source != "given"
        and keeps(one.gains, one.loop, settings)
        and not (one.name in spreads and lost(spreads[one.name]))
        and (settings.reference is not None or one.figures.overshoot <= MOST_OVERSHOOT)
    ]
    if not fit:
        return None
    least = min(scores[one.name] for one in fit)
    near = [one for one in fit if scores[one.name] <= _NEARLY * least]
    return min(near, key=lambda one: (one.noise_gain, scores[one.name])).name
