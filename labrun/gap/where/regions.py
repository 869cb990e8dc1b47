"""Parts of the data by what moves: regions of coordinate, rate, load and input, and what lies near reversals."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from labrun.gap.where.motion import Mover
from labrun.gap.where.parts import Layout, Part
from labrun.gap.where.wording import plain

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_END = 0.85
"""Part of the travel to each side beyond which a coordinate is near its end."""
_SLOW = 0.1
_OFF_CENTRE = 0.5
_NEAR_S = 0.1
_MOST_OF_A_STROKE = 0.2
"""What is near a reversal is at most this part of the time to the next one."""


def site_parts(mover: Mover, layout: Layout) -> list[Part]:
    """Return the regions of a joint or body site: quadrants, ends of its travel, slow motion, thirds of its load."""
    every = np.concatenate(mover.coordinate)
    low, high = float(every.min()), float(every.max())
    half = 0.5 * (high - low)
    centre = 0.5 * (high + low)
    if abs(centre) < _OFF_CENTRE * half:
        centre = 0.0  # rest positions are zero mostly: a travel that straddles it is told by its sign
    peak = mover.peak_rate()
    name = plain(mover.label)
    side, other = (
        ("positive", "negative") if centre == 0.0 else (f"above {centre:.3g}", f"below {centre:.3g}")
    )
    above, below = ("on the positive side", "on the negative side") if centre == 0.0 else (side, other)

    def part(at: str, text: str, inside: Callable[[FloatArray, FloatArray], BoolArray]) -> Part:
        masks = [inside(q, rate) for q, rate in zip(mover.coordinate, mover.rate, strict=True)]
        return Part("state", f"{mover.name}: {at}", f"{text} of {name}", layout.samples(masks))

    parts = [
        part(
            f"{side if up else other}, {'rising' if rises else 'falling'}",
            f"{'rising' if rises else 'falling'} motion {above if up else below}",
            lambda q, rate, up=up, rises=rises: ((q > centre) == up) & ((rate > 0) == rises),  # type: ignore[misc]
        )
        for up in (True, False)
        for rises in (True, False)
    ]
    middle = 0.5 * (high + low)
    parts += [
        part("upper end", "the upper end of the travel", lambda q, _: q > middle + _END * half),
        part("lower end", "the lower end of the travel", lambda q, _: q < middle - _END * half),
        part("ends of travel", "the ends of the travel", lambda q, _: np.abs(q - middle) > _END * half),
        part("slow", "slow motion", lambda _, rate: np.abs(rate) < _SLOW * peak),
    ]
    if mover.load:
        parts += _thirds(mover.load, layout, f"{mover.name}: load", f"load at {name}", absolute=True)
    return parts


def input_parts(mover: Mover, layout: Layout) -> list[Part]:
    """Return the thirds of an input's range."""
    return _thirds(mover.coordinate, layout, mover.label, plain(mover.name), absolute=False)


def _thirds(
    values: Sequence[FloatArray], layout: Layout, at: str, what: str, *, absolute: bool
) -> list[Part]:
    sizes = [np.abs(one) if absolute else one for one in values]
    every = np.concatenate(sizes)
    low, high = float(every.min()), float(every.max())
    if not high > low:
        return []
    edges = (-np.inf, low + (high - low) / 3, low + 2 * (high - low) / 3, np.inf)
    return [
        Part(
            "state",
            f"{at} {name}",
            f"{name} values of {what}",
            layout.samples([(one >= edges[place]) & (one < edges[place + 1]) for one in sizes]),
        )
        for place, name in enumerate(("low", "middle", "high"))
    ]


def reversal_parts(mover: Mover, layout: Layout) -> list[Part]:
    """Return what lies within 100 ms of a reversal (less where strokes are short), and what does not."""
    turns = [mover.reversals(index, piece.time_s) for index, piece in enumerate(layout.pieces)]
    strokes = np.concatenate([np.diff(one) for one in turns])
    if sum(map(len, turns)) == 0:
        return []
    near_s = min(_NEAR_S, _MOST_OF_A_STROKE * float(np.median(strokes))) if strokes.size else _NEAR_S
    masks = []
    for one, piece in zip(turns, layout.pieces, strict=True):
        away = np.abs(piece.time_s[:, None] - one[None, :]).min(axis=1, initial=np.inf)
        masks.append(away <= near_s)
    name, within = plain(mover.label), f"{1e3 * near_s:.0f} ms"
    near = layout.samples(masks)
    return [
        Part("reversal", mover.name, f"the {within} before and after reversals of {name}", near),
        Part(
            "reversal",
            f"away from reversals of {mover.name}",
            f"what is away from reversals of {name}",
            ~near,
        ),
    ]
