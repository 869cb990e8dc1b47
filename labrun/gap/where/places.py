"""Where a recalibrated model and the measurement differ: every part weighed, and the answer in one sentence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria
from labrun.gap.diagnosis import By, Place
from labrun.gap.where.difference import Difference, Mover, input_movers, pieces, site_movers
from labrun.gap.where.parts import (
    JOINT,
    Part,
    SampleLayout,
    channel_parts,
    condition_parts,
    in_each_condition,
    input_parts,
    joined_conditions,
    reversal_parts,
    site_parts,
)
from labrun.gap.where.periods import Spectra, band_parts, piece_cycles, quarter_parts, stroke_parts
from labrun.gap.where.significance import Finding, weigh

_CONDITIONS_HOLD = 0.75
"""Conditions are named until they hold this part of what all of them hold."""
_MAINLY = 0.6
_NOTABLE = 0.4
"""Share from which a half of the data, and a smaller part, is worth a sentence."""
_SPECIAL = 1.3
"""How many times its part of the data a condition or stroke must hold to be named."""
_SIMPLER_TO_SAY = 1.3
"""How much more a value of one key says than as many conditions named one by one."""

Note = Callable[[str], None]


def find_places(
    difference: Difference,
    rng: np.random.Generator,
    *,
    draws: int = 200,
    note: Note = lambda _: None,
) -> tuple[Place, ...]:
    """Divide the excess of the squared residual over the noise floor in every way that means something here.

    By channel, condition, phase of the cycle, frequency band, region of coordinate, rate, load and input, and around
    reversals. What the data do not allow is left out: no phase without a cycle, and of trials that are one sample each
    only channels and conditions.

    Parameters
    ----------
    difference
        Recalibrated model beside the data.
    rng
        Redraws the noise.
    draws
        How often. The smallest p is 1 / (draws + 1).
    note
        Is told in sentences what there is to know about the shares and their p.

    Returns
    -------
    places
        Those beyond chance first, and of these the ones first that hold much of the excess, and more than their part
        of the data; of frequencies, more than their part of the signal's power, too, since what is wrong by a few per
        cent is wrong where the signal is. Parts that are cut by condition too have a bar in their name,
        ``"recovery stroke | frequency_hz = 0.3"``, and come behind those that are not.
    """
    layout = SampleLayout(pieces(difference.units), len(difference.model.outputs))
    spectra = Spectra(layout)
    parts = _distinct(_parts(difference, layout, spectra))

    def densities(scaled: Sequence[FloatArray]) -> dict[str, FloatArray]:
        values = [piece.of(scaled) for piece in layout.pieces]
        return {
            "time": np.concatenate([np.square(one).ravel() for one in values]),
            "frequency": spectra.power(values),
        }

    finding = weigh(difference, parts, densities, rng, draws)
    _say(difference, finding, note)
    makes_up = np.maximum(finding.data_share, _of_signal(difference, layout, spectra, parts))
    return (*_placed(difference, parts, finding, makes_up),)


def _parts(difference: Difference, layout: SampleLayout, spectra: Spectra) -> list[Part]:
    sites, inputs = site_movers(difference, layout.pieces), input_movers(difference, layout.pieces)
    parts = [*channel_parts(difference, layout), *condition_parts(difference, layout)]
    for mover in inputs:
        parts += input_parts(mover, layout)
    if all(piece.length < 2 for piece in layout.pieces):
        return parts
    for mover in sites:
        parts += site_parts(mover, layout)
    turning: tuple[Mover, ...] = sites or inputs
    for mover in turning:
        parts += reversal_parts(mover, layout)
    cycles = piece_cycles(difference, layout, sites, inputs)
    strokes = stroke_parts(layout, cycles, turning)
    parts += [*strokes, *quarter_parts(layout, cycles), *in_each_condition(difference, layout, strokes)]
    simulated = [piece.first(difference.simulated) for piece in layout.pieces]
    return [*parts, *band_parts(spectra, cycles, simulated, driven=bool(inputs))]


def _distinct(parts: Sequence[Part]) -> list[Part]:
    """Leave out parts that hold nothing, and those that hold all and are no channel."""
    return [
        part for part in parts if np.any(part.members) and (part.by == "channel" or not np.all(part.members))
    ]


def _of_signal(
    difference: Difference, layout: SampleLayout, spectra: Spectra, parts: Sequence[Part]
) -> FloatArray:
    """Return the part of the simulated signals' power, about their means, that bands of frequencies hold; else 0."""
    simulated = [piece.first(difference.simulated) for piece in layout.pieces]
    power = spectra.power([(one - one.mean(axis=0)) / difference.scale for one in simulated])
    total = float(power.sum())
    banded = [part.view == "frequency" and total > 0 for part in parts]
    return np.array(
        [
            float(power[part.members].sum()) / total if one else 0.0
            for part, one in zip(parts, banded, strict=True)
        ]
    )


def _say(difference: Difference, finding: Finding, note: Note) -> None:
    if not difference.noise.known:
        note(
            "Nothing was repeated, so that gap and noise cannot be told apart by their size: shares are of the whole "
            "residual, noise included, and p asks whether it lies where it does by chance."
        )
    elif finding.quiet:
        note("No part of the data holds more than noise does: there is nothing to place.")


def _placed(
    difference: Difference,
    parts: Sequence[Part],
    finding: Finding,
    makes_up: FloatArray,
) -> list[Place]:
    ranked: list[tuple[bool, bool, float, Place]] = []
    untold = _channels_that_told_their_noise(difference)
    for index, part in enumerate(parts):
        share = float(finding.share[index])
        p = None if part.by == "channel" and part.at in untold else float(finding.p[index])
        lift = share / max(float(makes_up[index]), 1e-12)
        place = Place(part.by, part.at, share, p, part.text, float(makes_up[index]))
        ranked.append(
            (p is None or p > criteria.STANDS_OUT, JOINT in part.at, -max(lift, 0.0) * share, place)
        )
    return [place for *_, place in sorted(ranked, key=lambda one: one[:3])]


def _channels_that_told_their_noise(difference: Difference) -> set[str]:
    """Return the channels whose noise is known from their own residual alone: they cannot stand out from that."""
    outputs = difference.model.outputs
    units = difference.output_units
    alone = not difference.noise.known
    return {one.name for one, unit in zip(outputs, units, strict=True) if alone and units.count(unit) == 1}


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
    beyond = [one for one in places if one.share > 0 and (one.p is None or one.p <= criteria.STANDS_OUT)]
    told = any(one.p is not None for one in places)
    if not beyond or (told and all(one.p is None for one in beyond)):
        return "No part of the data stands out from the noise."
    clauses = [*_cut(beyond, places, conditions), *_conditions(beyond, conditions)]
    best = max(
        (one for one in clauses if one.lift >= _SPECIAL),
        key=lambda one: one.share * one.lift,
        default=None,
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
            lift = _SIMPLER_TO_SAY * one.share * len(heads) * len(conditions) / members
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
            found.append(
                _Clause(one.share, one.text, _SIMPLER_TO_SAY * one.share * len(conditions) / members)
            )
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
        if share >= _CONDITIONS_HOLD * whole and one.share < 0.5 * ordered[0].share:
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
