"""Which parts of the data tell where the gap is: chosen from all that were looked at, and put into words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labrun.gap import By, CandidateVerdict, Place, RatedCandidate

SIGNIFICANT = 0.05
_RANK: Mapping[CandidateVerdict, int] = {"cause": 0, "indistinguishable": 1, "ruled-out": 2, "not-visible": 3}
_MOST_BARS = 6
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
    "equation": "in",
}
_LOCATING = frozenset(
    (
        "in",
        "at",
        "on",
        "from",
        "with",
        "between",
        "within",
        "above",
        "below",
        "away",
        "near",
        "after",
        "before",
    )
)
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
    for place in where:
        if math.isfinite(place.share):
            groups.setdefault(place.by, []).append(place)
    found = []
    for by, places in groups.items():
        if by == "channel" and len(places) < 2:
            continue
        kept = sorted(places[:_MOST_BARS], key=lambda place: -place.share)
        found.append(PlacesPanel(by, tuple(kept), len(places) - len(kept)))
    return found[:most]


def hot_spots(where: Sequence[Place], most: int = 3) -> list[HotSpot]:
    """Return, for each way of dividing the data that is uneven beyond chance, the part that stands out.

    Before them comes a part that is narrower still (the recovery stroke at 0.4 Hz) if it holds most of the excess.
    """
    found = []
    for panel in panels(where):
        whole = [place for place in where if place.by == panel.by and _CUT_TWICE not in place.at]
        first = next((place for place in whole if math.isfinite(place.share)), None)
        if first is None or not beyond_chance(first) or not _tells(first):
            continue
        mean = sum(place.share for place in whole) / len(whole)
        if len(whole) > 1 and not first.share >= _STANDS_OUT * mean:
            continue
        found.append(_spot(first))
    return [*_narrow(where), *found][:most]


def beyond_chance(place: Place) -> bool:
    """Tell whether noise alone hardly gives a part as much; True where that cannot be told."""
    return place.p is None or place.p <= SIGNIFICANT


def _tells(place: Place) -> bool:
    return place.part is None or place.share >= _TELLS * place.part


def _spot(place: Place) -> HotSpot:
    # a part can hold more than all of the excess where others are below the noise; in words that is all of it
    return HotSpot(place.by, located(place), min(place.share, 1.0), place.p)


def _narrow(where: Sequence[Place]) -> list[HotSpot]:
    """Return the part cut in two ways that holds most of the excess all the same, if there is one."""
    held = [
        place
        for place in where
        if _CUT_TWICE in place.at and place.share >= _MOST and beyond_chance(place) and _tells(place)
    ]
    first = max(held, key=lambda place: place.share, default=None)
    return [] if first is None else [_spot(first)]


def place_words(place: Place) -> str:
    """Return a place as a person says it."""
    return place.text or place.at


def located(place: Place) -> str:
    """Return ``at release = 10 deg``, ``in the recovery stroke``; what says it already stays as it is."""
    text = place_words(place)
    first = text.partition(" ")[0]
    if first in _LOCATING:
        return text
    # "the torque at 0.3 Hz" is a part of a channel under a condition
    return f"in {text}" if first == "the" and place.by != "frequency" else f"{_PREPOSITIONS[place.by]} {text}"


def ranked(candidates: Sequence[RatedCandidate]) -> list[RatedCandidate]:
    """Return candidates by verdict, then by what they remove on data their fit did not see, then by evidence."""

    def key(one: RatedCandidate) -> tuple[int, float, float]:
        # what was not tried by itself and what makes matters worse are in order of their evidence
        return _RANK[one.verdict], -max(one.held_out_share or 0.0, 0.0), -one.evidence

    return sorted(candidates, key=key)
