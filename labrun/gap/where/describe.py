"""Where the gap is, in one sentence."""

from collections.abc import Sequence
from dataclasses import dataclass

from labrun.gap.diagnosis import By, Place
from labrun.gap.where.parts import JOINT
from labrun.gap.where.significance import CERTAIN
from labrun.gap.where.wording import joined_conditions

_MOST = 0.75
"""Conditions are named until they hold this part of what all of them hold."""
_MAINLY = 0.6
_NOTABLE = 0.4
_SPECIAL = 1.3
"""How many times its part of the data a condition or stroke must hold to be named."""
_SIMPLER = 1.3
"""How much more a value of one key says than as many conditions named one by one."""
_OTHER: tuple[By, ...] = ("phase", "reversal", "state", "frequency")


@dataclass(frozen=True)
class _Clause:
    share: float
    text: str
    lift: float


def describe(places: Sequence[Place], conditions: Sequence[str] = ()) -> str:
    """Return one sentence such as "80 % of it is in the recovery stroke at 0.3 and 0.4 Hz, mostly in the torque".

    Parameters
    ----------
    places
        Of `find_places`, in their order.
    conditions
        Labels of all conditions (`Dataset.conditions`).
    """
    beyond = [one for one in places if one.share > 0 and (one.p is None or one.p <= CERTAIN)]
    told = any(one.p is not None for one in places)
    if not beyond or (told and all(one.p is None for one in beyond)):
        return "No part of the data stands out from the noise."
    clauses = [*_cut(beyond, places, conditions), *_conditions(beyond, conditions)]
    best = max(
        (one for one in clauses if one.lift >= _SPECIAL), key=lambda one: one.share * one.lift, default=None
    )
    plain = next(
        (one for one in beyond if one.by in _OTHER and _simple(one) and one.share >= _least(one)), None
    )
    words = []
    if best is not None and best.share >= _NOTABLE:
        words.append(f"{_percent(best.share)} of it is {best.text}")
    elif plain is not None:
        words.append(f"{_percent(plain.share)} of it is {_in(plain)}")
    else:
        words.append("it is spread over all conditions and phases")
    channels = [one for one in places if one.by == "channel"]
    top = max(channels, key=lambda one: one.share, default=None)
    if top is not None and len(channels) > 1 and top.share >= _MAINLY and top.text not in words[0]:
        words.append(f"mostly in {top.text}")
    sentence = ", ".join(words)
    lacking = next((one for one in beyond if one.by == "equation" and one.share >= 0.5), None)
    if lacking is not None:
        output = lacking.at.endswith("(output)")
        sentence += f"; {lacking.text} is wrong" if output else f"; {lacking.text} lacks a term"
    return sentence[0].upper() + sentence[1:] + "."


def _cut(beyond: Sequence[Place], places: Sequence[Place], conditions: Sequence[str]) -> list[_Clause]:
    """Return for every part that was cut by condition the few conditions that hold most of it."""
    found = []
    singles = set(conditions)
    heads = dict.fromkeys(one.at.partition(JOINT)[0] for one in places if JOINT in one.at)
    for head in heads:
        cells = [one for one in beyond if one.at.partition(JOINT)[::2] in {(head, name) for name in singles}]
        text = next((one.text for one in places if one.at == head), head)
        if cells:
            clause = _fewest(cells, len(conditions))
            found.append(_Clause(clause.share, f"in {text}{clause.text}", clause.lift * len(heads)))
    for one in beyond:
        members = _members(one.at.partition(JOINT)[2], conditions)
        if JOINT in one.at and members > 1:
            lift = _SIMPLER * one.share * len(heads) * len(conditions) / members
            found.append(_Clause(one.share, f"in {one.text}", lift))
    return found


def _members(value: str, conditions: Sequence[str]) -> int:
    """Return how many conditions have a value such as "trajectory = sine"; 0 where it is a condition by itself."""
    return 0 if value in conditions else sum(value in label.split(", ") for label in conditions)


def _conditions(beyond: Sequence[Place], conditions: Sequence[str]) -> list[_Clause]:
    """Return the few conditions that hold most, and the values of one key that do."""
    places = [one for one in beyond if one.by == "condition" and JOINT not in one.at]
    found = []
    for one in places:
        members = _members(one.at, conditions)
        if members:
            found.append(_Clause(one.share, one.text, _SIMPLER * one.share * len(conditions) / members))
    cells = [one for one in places if one.at in conditions]
    clause = _fewest(cells, len(conditions)) if cells else None
    if clause is not None and clause.text:
        found.append(_Clause(clause.share, clause.text.strip(), clause.lift))
    return found


def _fewest(cells: Sequence[Place], number: int) -> _Clause:
    """Return the fewest conditions that hold most of what all these hold; no text where they are all there are."""
    ordered = sorted(cells, key=lambda one: -one.share)
    whole, share, chosen = sum(one.share for one in cells), 0.0, []
    for one in ordered:
        if share >= _MOST * whole and one.share < 0.5 * ordered[0].share:
            break
        chosen.append(one)
        share += one.share
    names = [one.at.partition(JOINT)[2] or one.at for one in chosen]
    words = f" {joined_conditions(names)}" if len(chosen) < number else ""
    return _Clause(share, words, share * number / len(chosen))


def _in(place: Place) -> str:
    at = place.by == "frequency" or "end of the travel" in place.text or "ends of the travel" in place.text
    return f"{'at' if at else 'in'} {place.text}"


def _least(place: Place) -> float:
    """Return the share from which a part is worth a sentence: more for halves of the data than for smaller parts."""
    return (
        _MAINLY if place.at.endswith("stroke") or place.at.startswith(("rising ", "falling ")) else _NOTABLE
    )


def _simple(place: Place) -> bool:
    return JOINT not in place.at and not place.at.startswith("away ")


def _percent(share: float) -> str:
    return f"{100 * min(max(share, 0.0), 1.0):.0f} %"
