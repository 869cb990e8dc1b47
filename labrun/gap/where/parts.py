"""Parts of the data by channel, condition, and region of what moves, with their names for people."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.experiment import Condition, condition_text, only, value_text, varying
from labrun.gap.diagnosis import By
from labrun.gap.where.difference import ConditionData, Difference, Mover
from labrun.toml import UNITS, split_unit

_FEW_SAMPLES = 8
"""Trials of fewer samples are taken for single measurements."""
_MOST_CUT = 12
"""Conditions beyond which a part is not looked at in each of them apart."""
_NEAR_END = 0.85
"""Part of the travel to each side beyond which a coordinate is near its end."""
_SLOW_MOTION = 0.1
"""Part of the peak rate below which motion is slow."""
_OFF_CENTRE = 0.5
"""Part of half the travel by which its middle must be off zero to be told from it."""
_NEAR_REVERSAL_S = 0.1
"""Time before and after a reversal that counts as near it."""
_PART_OF_STROKE = 0.2
"""Part of the time between reversals that counts as near one, at most."""

_FREQUENCIES = ("frequency", "freq", "f", "drive_frequency")


def plain(name: str) -> str:
    """Return a name without underscores."""
    return name.replace("_", " ")


def channel_text(name: str) -> str:
    """Return "the torque"; a symbol, such as ``phi`` or ``theta_2``, stands alone."""
    symbol = len(name) <= len("phi") or any(letter.isdigit() for letter in name)
    return plain(name) if symbol else f"the {plain(name)}"


def key_parts(key: str) -> tuple[str, str]:
    """Return what a condition key measures and its unit, both for people; the unit may be empty."""
    stem, suffix = split_unit(key)
    return plain(stem), "" if suffix is None else UNITS[suffix].label


def located(condition: Condition) -> str:
    """Return "at 0.3 Hz", "at amplitude 40 deg and 1 Hz", "at 0.3 Hz (buckling one side)", "with buckling one side"."""
    numbers, words = [], []
    for key, value in condition.items():
        what, unit = key_parts(key)
        if isinstance(value, str):
            words.append(f"{what} {value}")
        elif unit == "Hz" and what in _FREQUENCIES:
            numbers.append(value_text(value, unit))
        else:
            numbers.append(f"{what} {value_text(value, unit)}")
    if not numbers:
        return f"with {join(words)}" if words else ""
    return f"at {join(numbers)}" + (f" ({', '.join(words)})" if words else "")


def join(words: Sequence[str]) -> str:
    """Return "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


BoolArray = NDArray[np.bool_]
View = Literal["time", "frequency"]

JOINT = " | "
"""Between the two ways of dividing the data in `Place.at`: "recovery stroke | frequency_hz = 0.3"."""


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
class SampleLayout:
    """Where every piece's samples stand in a flat vector over all pieces, samples and channels."""

    pieces: tuple[ConditionData, ...]
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
            [np.full(piece.length, is_chosen) for piece, is_chosen in zip(self.pieces, chosen, strict=True)]
        )

    def channel(self, column: int) -> BoolArray:
        """Return all entries of a channel."""
        mask = np.zeros(self.channels, dtype=bool)
        mask[column] = True
        return np.tile(mask, sum(piece.length for piece in self.pieces))


def channel_parts(difference: Difference, layout: SampleLayout) -> list[Part]:
    """Return one part per output."""
    return [
        Part("channel", output.name, channel_text(output.name), layout.channel(column))
        for column, output in enumerate(difference.model.outputs)
    ]


@dataclass(frozen=True)
class ConditionSet:
    """Some of the conditions: one, or all that have a value in common. `single` tells which."""

    at: str
    text: str
    chosen: tuple[bool, ...]
    single: bool


def condition_sets(difference: Difference, pieces: Sequence[ConditionData]) -> list[ConditionSet]:
    """Return every condition, and every value of every condition key.

    Sets that are all of the data, or that come twice, are left out.
    """
    whole = [piece.trial.condition for piece in pieces]
    names = varying(whole)
    conditions = [only(condition, names) for condition in whole]
    sets: dict[tuple[bool, ...], ConditionSet] = {}

    def add(at: str, text: str, chosen: tuple[bool, ...], single: bool = False) -> None:
        if any(chosen) and not all(chosen):
            sets.setdefault(chosen, ConditionSet(at, text, chosen, single))

    for group, label in enumerate(difference.units.conditions):
        chosen = tuple(piece.group == group for piece in pieces)
        if any(chosen):
            add(label, located(conditions[chosen.index(True)]) or label, chosen, True)
    for key in _keys(conditions):
        for value in dict.fromkeys(condition[key] for condition in conditions if key in condition):
            chosen = tuple(condition.get(key) == value for condition in conditions)
            add(condition_text({key: value}), located({key: value}), chosen)
    return list(sets.values())


def _keys(conditions: Sequence[Mapping[str, float | str]]) -> list[str]:
    return list(dict.fromkeys(key for condition in conditions for key in condition))


def condition_parts(difference: Difference, layout: SampleLayout) -> list[Part]:
    """Return the conditions; where trials are single samples, also each channel in each of them."""
    few = bool(np.median([piece.length for piece in layout.pieces]) <= _FEW_SAMPLES)
    sets = condition_sets(difference, layout.pieces)
    parts = [
        Part("condition", condition_set.at, condition_set.text, layout.whole(condition_set.chosen))
        for condition_set in sets
    ]
    if few and layout.channels > 1:
        for column, output in enumerate(difference.model.outputs):
            parts += [
                Part(
                    "condition",
                    f"{output.name}{JOINT}{condition_set.at}",
                    f"{channel_text(output.name)} {condition_set.text}",
                    layout.whole(condition_set.chosen) & layout.channel(column),
                )
                for condition_set in sets
            ]
    return parts


def in_each_condition(difference: Difference, layout: SampleLayout, parts: Sequence[Part]) -> list[Part]:
    """Return parts of the time view cut by condition; none where there are too many conditions for that, or one."""
    singles = [
        condition_set for condition_set in condition_sets(difference, layout.pieces) if condition_set.single
    ]
    if not 2 <= len(singles) <= _MOST_CUT:
        return []
    return [
        Part(
            part.by,
            f"{part.at}{JOINT}{single.at}",
            f"{part.text} {single.text}",
            part.members & layout.whole(single.chosen),
        )
        for part in parts
        for single in singles
    ]


def site_parts(mover: Mover, layout: SampleLayout) -> list[Part]:
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
        part("upper end", "the upper end of the travel", lambda q, _: q > middle + _NEAR_END * half),
        part("lower end", "the lower end of the travel", lambda q, _: q < middle - _NEAR_END * half),
        part(
            "ends of travel",
            "the ends of the travel",
            lambda q, _: np.abs(q - middle) > _NEAR_END * half,
        ),
        part("slow", "slow motion", lambda _, rate: np.abs(rate) < _SLOW_MOTION * peak),
    ]
    if mover.load:
        parts += _thirds(mover.load, layout, f"{mover.name}: load", f"load at {name}", absolute=True)
    return parts


def input_parts(mover: Mover, layout: SampleLayout) -> list[Part]:
    """Return the thirds of an input's range."""
    return _thirds(mover.coordinate, layout, mover.label, plain(mover.name), absolute=False)


def _thirds(
    values: Sequence[FloatArray], layout: SampleLayout, at: str, what: str, *, absolute: bool
) -> list[Part]:
    sizes = [np.abs(value) if absolute else value for value in values]
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
            layout.samples([(size >= edges[index]) & (size < edges[index + 1]) for size in sizes]),
        )
        for index, name in enumerate(("low", "middle", "high"))
    ]


def reversal_parts(mover: Mover, layout: SampleLayout) -> list[Part]:
    """Return what lies within 100 ms of a reversal (less where strokes are short), and what does not."""
    turns = [mover.reversals(index, piece.time_s) for index, piece in enumerate(layout.pieces)]
    strokes = np.concatenate([np.diff(turn) for turn in turns])
    if sum(map(len, turns)) == 0:
        return []
    near_s = (
        min(_NEAR_REVERSAL_S, _PART_OF_STROKE * float(np.median(strokes)))
        if strokes.size
        else _NEAR_REVERSAL_S
    )
    masks = []
    for turn, piece in zip(turns, layout.pieces, strict=True):
        away = np.abs(piece.time_s[:, None] - turn[None, :]).min(axis=1, initial=np.inf)
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
