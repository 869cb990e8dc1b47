"""Words for the results of a diagnosis: verdicts, sizes, values, and locations of the gap."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labrun.estimate import Estimate, rounded
from labrun.gap import By, CandidateVerdict, Cause, Diagnosis, Place, RatedCandidate, ResampledNumber
from labrun.report.text import counted, listed, number, percent, spaced, unit_text

VERDICTS: Mapping[CandidateVerdict, str] = {
    "cause": "cause",
    "rival": "rival",
    "not-needed": "not needed",
    "excluded": "excluded above",
    "not-visible": "not visible in these data",
}
HEADLINES = {
    "no-gap": "no gap",
    "explained": "explained",
    "mostly-explained": "mostly explained",
    "partly-explained": "partly explained",
    "unexplained": "unexplained",
    "cannot-tell": "cannot tell",
}
_TAKE_PREFIX = ("N", "m", "s", "rad", "V", "A", "W", "Pa")
_SMALL = 2e-3

SIGNIFICANT = 0.05
_RANK: Mapping[CandidateVerdict, int] = {
    "cause": 0,
    "rival": 1,
    "not-needed": 2,
    "excluded": 2,
    "not-visible": 3,
}
_MOST_BARS, _MOST_SPOTS = 6, 3
_STANDS_OUT = 1.5
"""A part whose share is so many times the mean of its kind is worth a sentence."""
_MOST = 0.5
_TELLS = 1.2
"""A share that is less than so many times what the part makes up of the data says nothing about where the gap is."""
_PREPOSITIONS: dict[By, str] = {
    "channel": "in",
    "condition": "at",
    "phase": "in",
    "frequency": "at",
    "state": "in",
    "reversal": "in",
}
_LOCATING = frozenset(
    ["in", "at", "on", "from", "with", "between", "within", "above", "below", "away", "near", "after", "before"]
)  # fmt: skip
"""A place that begins so needs no other word before it."""
_CUT_TWICE = " | "
"""In `Place.at` of a part that is cut in two ways, which is part of a larger one."""


@dataclass(frozen=True, slots=True)
class PlacesPanel:
    """One way of dividing the data: its most telling parts, the largest share first. Parts may overlap.

    Attributes
    ----------
    others
        How many more there are.
    """

    by: By
    places: tuple[Place, ...]
    others: int


@dataclass(frozen=True, slots=True)
class HotSpot:
    """A part of the data that has much of the excess, in words."""

    by: By
    text: str
    share: float
    p: float | None


def panels(where: Sequence[Place], most: int | None = None) -> list[PlacesPanel]:
    """Return the ways of dividing the data, in the order in which `where` first has them: the most telling ones first.

    A single channel is no division.
    """
    groups: dict[By, list[Place]] = {}
    for location in where:
        if math.isfinite(location.share):
            groups.setdefault(location.by, []).append(location)
    shown = []
    for by, places in groups.items():
        if by == "channel" and len(places) < 2:
            continue
        kept = sorted(places[:_MOST_BARS], key=lambda location: -location.share)
        shown.append(PlacesPanel(by, tuple(kept), len(places) - len(kept)))
    return shown[:most]


def hot_spots(where: Sequence[Place]) -> list[HotSpot]:
    """Return, for each way of dividing the data that is uneven beyond chance, the part that stands out.

    Before them comes a part that is narrower still (the recovery stroke at 0.4 Hz) if it holds most of the excess.
    """
    spots = []
    for panel in panels(where):
        whole = [location for location in where if location.by == panel.by and _CUT_TWICE not in location.at]
        first = next((location for location in whole if math.isfinite(location.share)), None)
        if first is None or not beyond_chance(first) or not _tells(first):
            continue
        mean = sum(location.share for location in whole) / len(whole)
        if len(whole) > 1 and not first.share >= _STANDS_OUT * mean:
            continue
        spots.append(_spot(first))
    return [*_narrow(where), *spots][:_MOST_SPOTS]


def beyond_chance(location: Place) -> bool:
    """Tell whether the share of a part is significant; True if that is unknown."""
    return location.p is None or location.p <= SIGNIFICANT


def _tells(location: Place) -> bool:
    return location.part is None or location.share >= _TELLS * location.part


def _spot(location: Place) -> HotSpot:
    # a part can hold more than all of the excess where others are below the noise; in words that is all of it
    return HotSpot(location.by, located(location), min(location.share, 1.0), location.p)


def _narrow(where: Sequence[Place]) -> list[HotSpot]:
    """Return the part cut in two ways that holds most of the excess all the same, if there is one."""
    held = [
        location
        for location in where
        if _CUT_TWICE in location.at
        and location.share >= _MOST
        and beyond_chance(location)
        and _tells(location)
    ]
    first = max(held, key=lambda location: location.share, default=None)
    return [] if first is None else [_spot(first)]


def place_words(location: Place) -> str:
    """Return a place as a person says it."""
    return location.text or location.at


def located(location: Place) -> str:
    """Return ``at release = 10 deg``, ``in the recovery stroke``; what says it already stays as it is."""
    text = place_words(location)
    first = text.partition(" ")[0]
    if first in _LOCATING:
        return text
    # "the torque at 0.3 Hz" is a part of a channel under a condition
    return (
        f"in {text}"
        if first == "the" and location.by != "frequency"
        else f"{_PREPOSITIONS[location.by]} {text}"
    )


def ranked(candidates: Sequence[RatedCandidate]) -> list[RatedCandidate]:
    """Return candidates by status, then by the share of the gap that each closes by itself."""
    return sorted(candidates, key=lambda row: (_RANK[row.verdict], -(row.closes or 0.0)))


def status_words(row: RatedCandidate) -> str:
    """Return the status of a candidate: "rival of X", "excluded above torque 0.002 N m", "not needed"."""
    if row.verdict == "rival":
        return f"rival of {listed([name.words for name in row.same_as], 'and')}"
    if row.verdict == "excluded":
        return "; ".join(bound_words(row.upper_bound))
    return VERDICTS[row.verdict]


def closes_words(cause: Cause) -> str:
    """Return which share of the gap a cause closes, and its confidence."""
    if cause.closes < 0.0 < cause.returns:
        share = percent(min(cause.returns, 1.0))  # without it, the others may leave more than the gap
        text = f"closes {share} of the gap, together with the other causes only"
    else:
        text = f"closes {percent(cause.closes)} of the gap"
    if math.isfinite(cause.confidence):
        text += f"; confidence {percent(cause.confidence)} from resamples"
    return text


def reference_words(cause: Cause) -> str:
    """Return what the sizes of a cause refer to: "at reference 15 rad/s, exponent 2"."""
    parts = [
        f"{spaced(name)} {number(value, 3)}{'' if unit in ('', '1') else ' ' + unit_text(unit)}"
        for name, (value, unit) in cause.refers_to.items()
    ]
    return f"at {', '.join(parts)}" if parts else ""


def ladder_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the error on unseen data of each output: as stated, recalibrated, and with each cause in turn."""
    lines = []
    for output, unit in diagnosis.channels:
        values = [rung.errors.get(output, math.nan) for rung in diagnosis.ladder]
        finite = [value for value in values if math.isfinite(value)]
        largest = ResampledNumber(max(finite, default=0.0), 0.0, 0.0, unit)
        factor, suffix = _prefixed(largest)
        steps = [
            f"{rung.step if rung.cause is None else _short(rung.step)} {number(factor * value, 2)}"
            for rung, value in zip(diagnosis.ladder, values, strict=True)
        ]
        noise = number(factor * diagnosis.noise[output], 2)
        name = f"{spaced(output)}: " if len(diagnosis.channels) > 1 else ""
        lines.append(f"{name}{' > '.join(steps)}{suffix} (noise of one trial about {noise}{suffix})")
    return lines


def _short(step: str) -> str:
    return step.partition(" at ")[0]


def rest_words(diagnosis: Diagnosis) -> str:
    """Return the size of the rest, its predictable share, and the predictors."""
    rest = diagnosis.rest
    size = f"{times_noise(rest.in_noise)} times the noise"
    nested = None if rest.nested is None else times_noise(rest.nested)
    if nested is not None and nested != times_noise(rest.in_noise):
        size += f"; {nested} where the choice of causes has not seen the condition either"
    if rest.within_noise:
        return f"within the noise ({size})"
    text = f"{percent(rest.share_of_gap)} of the gap ({size})" if diagnosis.causes else size
    if rest.predictable is not None:
        signals = f" from {listed([spaced(name) for name in rest.depends_on])}" if rest.depends_on else ""
        text += f"; {percent(rest.predictable)} of its square is predictable{signals or ' from motion and inputs'}"
    if not diagnosis.complete:
        return f"{text}; the search was not finished"
    return f"{text}; nothing in the library explains it" if diagnosis.verdict != "explained" else text


def times_noise(value: float) -> str:
    """Return a size in units of one trial's noise: one decimal where that is enough, more where it is small."""
    if not math.isfinite(value):
        return number(value)
    if value == 0.0 or abs(value) >= 10:
        return f"{value:.0f}" if abs(value) < 1e5 else f"{value:.2g}"
    return f"{value:.1f}" if abs(value) >= 0.95 else f"{value:.2g}" if abs(value) >= 0.01 else f"{value:.1g}"


def estimate_words(
    estimate: ResampledNumber, *, prefix: bool = True, like: ResampledNumber | None = None
) -> str:
    """Return ``0.0120 [0.0110, 0.0130] N m``, with the digits that the interval supports.

    A small number is given in thousandths or millionths of its unit, unless without a `prefix`; in the same as another
    number it is `like`.
    """
    factor, unit = _prefixed(like or estimate) if prefix else (1.0, _after(estimate.unit))
    value, low, high = (factor * end for end in (estimate.value, estimate.low, estimate.high))
    if not all(math.isfinite(end) for end in (value, low, high)):
        return f"{number(value)} [{number(low)}, {number(high)}]{unit}"
    middle, least, most = rounded(Estimate(value, (low, high), estimate.unit))
    return f"{middle} [{least}, {most}]{unit}"


def value_words(values: Mapping[str, ResampledNumber]) -> list[str]:
    """Return ``torque 0.0120 [0.0110, 0.0130] N m`` of every value."""
    return [f"{spaced(name)} {estimate_words(estimate)}" for name, estimate in values.items()]


def bound_words(bounds: Mapping[str, ResampledNumber]) -> list[str]:
    """Return ``torque at most 0.0012 N m`` of every bound; one with different ends to either side says both.

    A least level, whose value is its near end, says ``level at least 0.8 N m``.
    """
    words = []
    for name, bound in bounds.items():
        factor, unit = _prefixed(bound)
        value, low, high = (factor * end for end in (bound.value, bound.low, bound.high))
        if value == low < high or not (low < 0 < high != -low or math.isfinite(high)):
            text = f"at least {number(low, 2)}"
        elif low < 0 < high != -low:
            text = f"between {number(low, 2)} and {number(high, 2)}"
        else:
            text = f"at most {number(max(value, high), 2)}"
        words.append(f"{spaced(name)} {text}{unit}")
    return words


def _prefixed(estimate: ResampledNumber) -> tuple[float, str]:
    """Return the factor and the prefixed unit for a small number."""
    finite = [abs(end) for end in (estimate.value, estimate.low, estimate.high) if math.isfinite(end)]
    largest = max(finite, default=0.0)
    if estimate.unit.split(" ")[0].split("/")[0] not in _TAKE_PREFIX or not 0 < largest < _SMALL:
        return 1.0, _after(estimate.unit)
    factor, prefix = (1e3, "m") if largest >= _SMALL**2 else (1e6, "\u00b5")
    return factor, f" {prefix}{estimate.unit}"


def _after(unit: str) -> str:
    return f" {unit}" if unit_text(unit) else ""


def never_seen(diagnosis: Diagnosis) -> str:
    """Return on what data the sizes after recalibration were found."""
    if diagnosis.conditions > 1:
        return "on conditions the fit never saw"
    return "on blocks of time the fit never saw, as there is only one condition"


def data_words(diagnosis: Diagnosis) -> str:
    """Return ``24 trials at 8 conditions, each measured at least 3 times``."""
    if diagnosis.repeats >= 2:
        repeats = f"each measured at least {diagnosis.repeats} times"
    else:
        repeats = "some measured repeatedly" if diagnosis.trials > diagnosis.conditions else "none repeated"
    return f"{counted(diagnosis.trials, 'trial')} at {counted(diagnosis.conditions, 'condition')}, {repeats}"
