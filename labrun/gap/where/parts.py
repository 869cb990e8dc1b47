"""Parts of the data: by channel, by condition, and both at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.gap.diagnosis import By
from labrun.gap.where.difference import Difference
from labrun.gap.where.pooling import Piece
from labrun.gap.where.wording import channel_text, joined_conditions, located, threshold_text
from labrun.spec import condition_text

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
View = Literal["time", "frequency"]

JOINT = " | "
"""Between the two ways of dividing the data in `Place.at`: "recovery stroke | frequency_hz = 0.3"."""
_FEW_SAMPLES = 8
_MOST_NAMED = 3
_MOST_JOINT = 12
"""Conditions beyond which a part is not looked at in each of them apart."""


@dataclass(frozen=True)
class Part:
    """A part of the data.

    Attributes
    ----------
    by, at, text
        As in `labrun.gap.diagnosis.Place`.
    members
        Which entries of the view belong to it: every piece's (n, m), or (frequencies, m), one after the other, flat.
    view
        Whether entries are samples or frequencies.
    """

    by: By
    at: str
    text: str
    members: BoolArray
    view: View = "time"


@dataclass(frozen=True)
class Layout:
    """Where every piece's samples stand in a flat vector over all pieces, samples and channels."""

    pieces: tuple[Piece, ...]
    channels: int

    @property
    def size(self) -> int:
        """Number of entries."""
        return sum(piece.length for piece in self.pieces) * self.channels

    def samples(self, masks: Sequence[BoolArray]) -> BoolArray:
        """Return the entries of samples, given by a mask (n,) for every piece, in all channels."""
        return np.concatenate([np.repeat(mask, self.channels) for mask in masks])

    def whole(self, chosen: Sequence[bool]) -> BoolArray:
        """Return all entries of some pieces."""
        return self.samples(
            [np.full(piece.length, one) for piece, one in zip(self.pieces, chosen, strict=True)]
        )

    def channel(self, column: int) -> BoolArray:
        """Return all entries of a channel."""
        mask = np.zeros(self.channels, dtype=bool)
        mask[column] = True
        return np.tile(mask, sum(piece.length for piece in self.pieces))


def channel_parts(difference: Difference, layout: Layout) -> list[Part]:
    """Return one part per output."""
    return [
        Part("channel", one.name, channel_text(one.name), layout.channel(column))
        for column, one in enumerate(difference.model.outputs)
    ]


@dataclass(frozen=True)
class ConditionSet:
    """Some of the conditions: one, or all that have a value in common. `single` tells which."""

    at: str
    text: str
    chosen: tuple[bool, ...]
    single: bool


def condition_sets(difference: Difference, pieces: Sequence[Piece], *, ranges: bool) -> list[ConditionSet]:
    """Return every condition, every value of every condition key, and with `ranges` all values from one on.

    Sets that are all of the data, or that come twice, are left out.
    """
    conditions = [dict(piece.trial.condition) for piece in pieces]
    found: dict[tuple[bool, ...], ConditionSet] = {}

    def add(at: str, text: str, chosen: tuple[bool, ...], single: bool = False) -> None:
        if any(chosen) and not all(chosen):
            found.setdefault(chosen, ConditionSet(at, text, chosen, single))

    for group, label in enumerate(difference.units.conditions):
        chosen = tuple(piece.group == group for piece in pieces)
        if any(chosen):
            add(label, located(conditions[chosen.index(True)]) or label, chosen, True)
    values = {
        key: list(dict.fromkeys(one[key] for one in conditions if key in one)) for key in _keys(conditions)
    }
    for key, several in values.items():
        for value in several:
            chosen = tuple(one.get(key) == value for one in conditions)
            labels = [
                difference.units.conditions[piece.group]
                for piece, yes in zip(pieces, chosen, strict=True)
                if yes
            ]
            named = isinstance(value, str) and 1 < len(labels) <= _MOST_NAMED
            text = joined_conditions(labels) if named else located({key: value})
            add(condition_text({key: value}), text, chosen)
    for key, several in values.items() if ranges else ():
        numbers = sorted(value for value in several if not isinstance(value, str))
        for low in numbers[1:] if len(numbers) == len(several) > 2 else ():
            reached = tuple(key in one and float(one[key]) >= low for one in conditions)
            add(f"{key} >= {low:g}", threshold_text(key, low, above=True), reached)
            add(f"{key} < {low:g}", threshold_text(key, low, above=False), tuple(not one for one in reached))
    return list(found.values())


def _keys(conditions: Sequence[Mapping[str, float | str]]) -> list[str]:
    return list(dict.fromkeys(key for one in conditions for key in one))


def condition_parts(difference: Difference, layout: Layout) -> list[Part]:
    """Return the conditions; where trials are single samples, also each channel in each of them."""
    few = bool(np.median([piece.length for piece in layout.pieces]) <= _FEW_SAMPLES)
    sets = condition_sets(difference, layout.pieces, ranges=few)
    parts = [Part("condition", one.at, one.text, layout.whole(one.chosen)) for one in sets]
    if few and layout.channels > 1:
        for column, output in enumerate(difference.model.outputs):
            parts += [
                Part(
                    "condition",
                    f"{output.name}{JOINT}{one.at}",
                    f"{channel_text(output.name)} {one.text}",
                    layout.whole(one.chosen) & layout.channel(column),
                )
                for one in sets
            ]
    return parts


def in_each_condition(difference: Difference, layout: Layout, parts: Sequence[Part]) -> list[Part]:
    """Return parts of the time view cut by condition; none where there are too many conditions for that, or one."""
    singles = [one for one in condition_sets(difference, layout.pieces, ranges=False) if one.single]
    if not 2 <= len(singles) <= _MOST_JOINT:
        return []
    return [
        Part(
            part.by,
            f"{part.at}{JOINT}{one.at}",
            f"{part.text} {one.text}",
            part.members & layout.whole(one.chosen),
        )
        for part in parts
        for one in singles
    ]
