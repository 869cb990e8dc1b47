"""Parts of the data by phase of the cycle: quarters and strokes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrun.gap.where.cycle import Cycle, find_cycle
from labrun.gap.where.difference import Difference
from labrun.gap.where.motion import Mover
from labrun.gap.where.parts import Layout, Part
from labrun.gap.where.wording import plain

FloatArray = NDArray[np.float64]

_QUARTERS = ("first", "second", "third", "last")
_OSCILLATES = 0.6
"""Part of the cycles' samples in which a site must move the way its fundamental does, for its strokes to be named."""


def piece_cycles(
    difference: Difference, layout: Layout, sites: Sequence[Mover], inputs: Sequence[Mover]
) -> tuple[Cycle | None, ...]:
    """Return the cycle of every piece: of what drives it, else of what moves, else of its outputs."""
    found = []
    for index, piece in enumerate(layout.pieces):
        signals = [mover.coordinate[index] for mover in (*inputs, *sites)]
        outputs = piece.first(difference.simulated)
        signals += [outputs[:, column] for column in range(layout.channels)]
        found.append(find_cycle(piece.time_s, signals, piece.trial.condition))
    return tuple(found)


def stroke_parts(layout: Layout, cycles: Sequence[Cycle | None], movers: Sequence[Mover]) -> list[Part]:
    """Return the strokes of the first site that moves, or of the first input; none where trials are not periodic.

    The stroke in which a site's coordinate rises is its forward stroke, the other one its recovery stroke.
    """
    if not movers or any(cycle is None for cycle in cycles):
        return []
    mover = movers[0]
    rises = [np.asarray(rate > 0) for rate in mover.rate]
    share = float(np.mean(np.concatenate(rises)))
    if not 1 - _OSCILLATES < share < _OSCILLATES + 0.2:
        return []
    name = plain(mover.name)
    members = layout.samples(rises)
    if mover.kind == "input":
        names = (f"rising {mover.name}", f"falling {mover.name}")
        texts = (
            f"the half of the cycle in which {name} rises",
            f"the half of the cycle in which {name} falls",
        )
    else:
        names = ("forward stroke", "recovery stroke")
        texts = (f"the forward stroke ({name} rises)", f"the recovery stroke ({name} falls)")
    return [Part("phase", names[0], texts[0], members), Part("phase", names[1], texts[1], ~members)]


def quarter_parts(layout: Layout, cycles: Sequence[Cycle | None]) -> list[Part]:
    """Return the quarters of the cycle; none where trials are not periodic."""
    if any(cycle is None for cycle in cycles):
        return []
    quarters = [
        np.floor(4 * cycle.phase(piece.time_s)).astype(int) % 4
        for cycle, piece in zip(cycles, layout.pieces, strict=True)
        if cycle is not None
    ]
    return [
        Part(
            "phase",
            f"{name} quarter",
            f"the {name} quarter of the cycle",
            layout.samples([np.asarray(one == place) for one in quarters]),
        )
        for place, name in enumerate(_QUARTERS)
    ]
