"""Where a recalibrated model and the measurement differ: the share of the gap that each part of the data holds."""

from collections.abc import Callable, Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap import criteria
from labrun.gap.diagnosis import Place
from labrun.gap.where.difference import Difference, Mover, input_movers, pieces, site_movers
from labrun.gap.where.parts import (
    JOINT,
    Part,
    SampleLayout,
    channel_parts,
    condition_parts,
    in_each_condition,
    input_parts,
    reversal_parts,
    site_parts,
)
from labrun.gap.where.periods import Spectra, band_parts, piece_cycles, stroke_parts
from labrun.gap.where.significance import Finding, weigh

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
            "time": np.concatenate([np.square(value).ravel() for value in values]),
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
    parts += [*strokes, *in_each_condition(difference, layout, strokes)]
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
    power = spectra.power([(first - first.mean(axis=0)) / difference.scale for first in simulated])
    total = float(power.sum())
    banded = [part.view == "frequency" and total > 0 for part in parts]
    return np.array(
        [
            float(power[part.members].sum()) / total if banded_part else 0.0
            for part, banded_part in zip(parts, banded, strict=True)
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
        location = Place(part.by, part.at, share, p, part.text, float(makes_up[index]))
        ranked.append(
            (p is None or p > criteria.STANDS_OUT, JOINT in part.at, -max(lift, 0.0) * share, location)
        )
    return [location for *_, location in sorted(ranked, key=lambda key: key[:3])]


def _channels_that_told_their_noise(difference: Difference) -> set[str]:
    """Return the channels whose noise is known from their own residual alone: they cannot stand out from that."""
    outputs = difference.model.outputs
    units = difference.output_units
    alone = not difference.noise.known
    return {
        output.name for output, unit in zip(outputs, units, strict=True) if alone and units.count(unit) == 1
    }
