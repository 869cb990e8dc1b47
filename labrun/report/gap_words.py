"""A diagnosis in words: names of candidates, numbers with their interval, and what a verdict means."""

import math
from collections.abc import Mapping

from labrun.fit.estimate import Estimate as FitEstimate
from labrun.fit.estimate import rounded
from labrun.gap.diagnosis import Candidate, CandidateVerdict, Cause, Diagnosis, Estimate, Name
from labrun.gap.numbers import significant
from labrun.report.html_words import spaced
from labrun.report.words import duration_text

SIGNIFICANT = 0.05
VERDICTS: Mapping[CandidateVerdict, str] = {
    "cause": "cause",
    "indistinguishable": "explains these data as well",
    "ruled-out": "ruled out",
    "not-visible": "not visible in these data",
}
HEADLINES = {
    "no-gap": "no gap",
    "parameter": "a parameter",
    "explained": "explained",
    "partly-explained": "explained in part",
    "not-in-library": "not in the library",
}
_TAKE_PREFIX = ("N", "m", "s", "rad", "V", "A", "W", "Pa")
_SMALL = 2e-3
_WORSE = 0.005
_RANK: Mapping[CandidateVerdict, int] = {"cause": 0, "indistinguishable": 1, "ruled-out": 2, "not-visible": 3}


def name_words(name: Name) -> str:
    """Return ``Coulomb friction at hinge``, or ``parameter inertia``."""
    return name.words


def listed(parts: list[str], last: str = "and") -> str:
    """Return ``a``, ``a and b``, ``a, b and c``."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}" if parts else ""


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many digits; what has no limit says so."""
    if math.isnan(value):
        return "not known"
    if math.isinf(value):
        return "no limit" if value > 0 else "no lower limit"
    return significant(value, digits)


def times_noise(value: float) -> str:
    """Return a size in units of one trial's noise: one decimal where that is enough, more where it is small."""
    if not math.isfinite(value):
        return number(value)
    if value == 0.0 or abs(value) >= 10:
        return f"{value:.0f}" if abs(value) < 1e5 else f"{value:.2g}"
    return f"{value:.1f}" if abs(value) >= 0.95 else f"{value:.2g}" if abs(value) >= 0.01 else f"{value:.1g}"


def percent(share: float, digits: int = 0) -> str:
    """Return a share in per cent; what rounds to nothing or to all without being it says so."""
    if not math.isfinite(share):
        return number(share)
    if 0 < share < 0.005:
        return "< 1\u00a0%"
    if 0.995 <= share < 1:
        return f"{math.floor(1000 * share) / 10:g}\u00a0%"
    text = f"{100 * share:.{digits}f}" if abs(share) < 1e4 else f"{100 * share:.2g}"
    return f"{'0' if text == '-0' else text}\u00a0%"


def removes_words(share: float) -> str:
    """Return how much of the excess a candidate removes, ``97 %``; of one that adds to it, that it does."""
    return "makes it worse" if share <= -_WORSE else percent(max(min(share, 1.0), 0.0))


def p_words(p: float | None) -> str:
    """Return ``p = 0.002``; nothing where it cannot be told."""
    if p is None:
        return ""
    level = "< 0.001" if p < 0.001 else f"= {p:.2g}" if p < 0.1 else f"= {p:.1f}"
    return f"p {level}".replace(" ", "\u00a0")


def estimate_words(estimate: Estimate, *, prefix: bool = True) -> str:
    """Return ``0.0120 [0.0110, 0.0130] N m``, with the digits that the interval supports.

    A small number is given in thousandths or millionths of its unit, unless without a `prefix`.
    """
    scaled, unit = _with_prefix(estimate) if prefix else (estimate, _after(estimate.unit))
    ends = (scaled.low, scaled.high)
    if not all(math.isfinite(end) for end in (scaled.value, *ends)):
        return f"{number(scaled.value)} [{number(ends[0])}, {number(ends[1])}]{unit}"
    value, low, high = rounded(FitEstimate(scaled.value, ends, scaled.unit))
    return f"{value} [{low}, {high}]{unit}"


def _with_prefix(estimate: Estimate) -> tuple[Estimate, str]:
    """Return a small number in thousandths or millionths of its unit, where that is usual, and the unit to write."""
    unit = _after(estimate.unit)
    finite = [abs(end) for end in (estimate.value, estimate.low, estimate.high) if math.isfinite(end)]
    largest = max(finite, default=0.0)
    if estimate.unit.split(" ")[0].split("/")[0] not in _TAKE_PREFIX or not 0 < largest < _SMALL:
        return estimate, unit
    prefix, factor = ("m", 1e3) if largest >= _SMALL**2 else ("\u00b5", 1e6)
    ends = (estimate.value * factor, estimate.low * factor, estimate.high * factor)
    return Estimate(*ends, estimate.unit), f" {prefix}{estimate.unit}"


def _after(unit: str) -> str:
    return "" if unit in ("1", "") else f" {unit}"


def value_words(values: Mapping[str, Estimate]) -> list[str]:
    """Return ``torque 0.0120 [0.0110, 0.0130] N m`` of every value."""
    return [f"{spaced(name)} {estimate_words(estimate)}" for name, estimate in values.items()]


def bound_words(bounds: Mapping[str, Estimate]) -> list[str]:
    """Return ``torque at most 0.0012 N m`` of every bound; one with different ends to either side says both.

    A least level, whose value is its near end, says ``level at least 0.8 N m``.
    """
    found = []
    for name, whole in bounds.items():
        bound, unit = _with_prefix(whole)
        if bound.value == bound.low < bound.high:
            found.append(f"{spaced(name)} at least {number(bound.low, 2)}{unit}")
        elif bound.low < 0 < bound.high != -bound.low:
            found.append(f"{spaced(name)} between {number(bound.low, 2)} and {number(bound.high, 2)}{unit}")
        elif math.isfinite(bound.high):
            found.append(f"{spaced(name)} at most {number(max(bound.value, bound.high), 2)}{unit}")
        else:
            found.append(f"{spaced(name)} at least {number(bound.low, 2)}{unit}")
    return found


def ranked(candidates: tuple[Candidate, ...]) -> list[Candidate]:
    """Return candidates by verdict, then by what they remove on data their fit did not see, then by evidence."""

    def key(one: Candidate) -> tuple[int, float, float]:
        # what was not tried by itself and what makes matters worse are in order of their evidence
        return _RANK[one.verdict], -max(one.held_out_share or 0.0, 0.0), -one.evidence

    return sorted(candidates, key=key)


def confidence_words(cause: Cause) -> str:
    """Return ``96 %``."""
    return percent(cause.confidence)


def never_seen(diagnosis: Diagnosis) -> str:
    """Return on what data the sizes after recalibration were found."""
    if diagnosis.conditions > 1:
        return "on conditions the fit never saw"
    return "on the data it was fitted to, as there is only one condition"


def took_words(seconds: float) -> str:
    """Return ``0.8 s``, ``14 s``, ``3 min 20 s``."""
    return duration_text(seconds) if seconds >= 10 else f"{seconds:.1f} s"


def data_words(diagnosis: Diagnosis) -> str:
    """Return ``24 trials at 8 conditions, at least 3 of each``."""
    trials = f"{diagnosis.trials} trial{'s' * (diagnosis.trials != 1)}"
    conditions = f"{diagnosis.conditions} condition{'s' * (diagnosis.conditions != 1)}"
    repeats = (
        "none repeated" if diagnosis.repeats < 2 else f"each measured at least {diagnosis.repeats} times"
    )
    return f"{trials} at {conditions}, {repeats}"
