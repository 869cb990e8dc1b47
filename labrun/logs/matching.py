"""Which column of a log is which input or output of a model, and in which unit: certain, or asked for."""

import difflib
import math
import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.logs.streams import Column, Role, Stream, plain

Unit = Literal["rad", "deg", "ticks", "normalised"]
TICKS = 4096
"""Steps of an encoder in one turn, its middle being zero, if nobody says: that of servos whose logs come in ticks."""
_BEYOND_RAD = 2.2 * math.pi
_SLACK = 1.05
_FULL_SHARE, _MOST_SHARE = 99.0, 100.5
"""What shares of a joint's range reach if all of it was used, and at most with rounding."""
_NUMBERED = re.compile(r"(?P<stem>\D*)(?P<number>\d+)")
_COMMANDS = ("command", "velocity-command", "torque-command")
_NOT = "none"


@dataclass(frozen=True)
class Wanted:
    """A channel that a model has.

    Attributes
    ----------
    channel
        Its name in the model, and in the recording that is made.
    unit
    kind
    names
        What a log may call it.
    roles
        What its column may be, most likely first.
    place, width
        Which one of how many it is, in the robot's own order.
    range
        What the joint can do, in `unit`.
    """

    channel: str
    unit: str
    kind: Literal["input", "output"]
    names: tuple[str, ...]
    roles: tuple[Role, ...]
    place: int = 0
    width: int = 1
    range: tuple[float, float] | None = None

    @property
    def goal(self) -> bool:
        """Tell whether it is a goal, which stands until the next one."""
        return self.kind == "input" and self.roles[0] in ("command", "velocity-command")


@dataclass(frozen=True)
class Match:
    """A wanted channel and its column; None where the log has none, and a person said so."""

    wanted: Wanted
    stream: Stream | None
    column: Column | None
    to_si: tuple[float, float] = (1.0, 0.0)
    """Factor and offset to the model's unit."""


def matched(
    wanted: Sequence[Wanted], streams: Sequence[Stream], asked: Mapping[str, str]
) -> tuple[list[Match], list[str]]:
    """Return each wanted channel's column, and how those that were not named alike were found.

    Parameters
    ----------
    asked
        What a person said with ``--map``: a channel or joint to a column, its stem, or ``none``.

    Raises
    ------
    RequestError
        Something is unclear: all of it, each with a proposal.
    """
    known = {plain(name) for one in wanted for name in (one.channel, *one.names)}
    for name in asked:
        if plain(name) not in known:
            raise RequestError(
                f"--map {name}=...: the model has no {name!r}", hint=f"it has {_listed(wanted)}"
            )
    found: list[Match] = []
    open_: list[tuple[Wanted, list[tuple[Stream, Column]], str | None]] = []
    said: list[str] = []
    for one in wanted:
        given = _asked_for(one, asked)
        if given == _NOT:
            found.append(Match(one, None, None))
            continue
        exact = plain(one.channel) in {plain(name) for name in asked}
        candidates = _candidates(one, streams, given, exact=exact)
        if len(candidates) != 1:
            open_.append((one, candidates, given))
            continue
        found.append(Match(one, *candidates[0]))
        if given is not None and plain(given) in map(plain, (candidates[0][1].name, candidates[0][1].stem)):
            said.append(f"{one.channel} is {candidates[0][1].name}, as --map says")
    taken = {id(one.column) for one in found}
    free = [(stream, column) for stream in streams for column in stream.columns if id(column) not in taken]
    have = sorted({column.name for stream in streams for column in stream.columns})
    unclear = [_question(one, candidates, free, given, have) for one, candidates, given in open_]
    unclear += _twice(found)
    if unclear:
        shown = ", ".join(have[:30]) + (f" and {len(have) - 30} more" if len(have) > 30 else "")
        lines = "\n".join(f"  {line}" for line in unclear)
        raise RequestError(
            f"it is not clear which columns of the log these are:\n{lines}\nthe log has {shown}",
            hint=_all_proposals(unclear),
        )
    return found, said


def _all_proposals(unclear: Sequence[str]) -> str:
    """Return how to answer, and where every question has a proposal, all of them to be copied."""
    how = "say it: --map CHANNEL=COLUMN, or --map CHANNEL=none for what the log does not have"
    given = [line.rpartition("--map ")[2] for line in unclear if "proposal" in line]
    if len(given) < len(unclear) or len(given) < 2:
        return how
    return f"{how}; if all of these are right: {shlex.join(part for one in given for part in ('--map', one))}"


def _twice(found: Sequence[Match]) -> list[str]:
    """Return a line for every column that was taken for more than one channel."""
    channels: dict[int, list[str]] = {}
    names: dict[int, str] = {}
    for one in found:
        if one.column is not None:
            channels.setdefault(id(one.column), []).append(one.wanted.channel)
            names[id(one.column)] = one.column.name
    return [
        f"{' and '.join(several)}: column {names[key]} was taken for all of them, and can be one only"
        for key, several in channels.items()
        if len(several) > 1
    ]


def _asked_for(one: Wanted, asked: Mapping[str, str]) -> str | None:
    by_plain = {plain(name): value for name, value in asked.items()}
    for name in (one.channel, *one.names):
        value = by_plain.get(plain(name))
        if value is not None:
            return value
    return None


def _candidates(
    one: Wanted, streams: Sequence[Stream], given: str | None, *, exact: bool
) -> list[tuple[Stream, Column]]:
    every = [(stream, column) for stream in streams for column in stream.columns]
    if given is not None:
        whole = [(stream, column) for stream, column in every if plain(column.name) == plain(given)]
        # --map pan=/cmd[0] is about the goal of pan where /cmd says that it is one
        told = one.kind == "output"
        fitting = [
            (stream, column)
            for stream, column in whole
            if column.role in one.roles or (exact and not (told and column.role in _COMMANDS))
        ]
        if fitting:
            return fitting
        if whole:  # --map shoulder=/cmd/shoulder is about the goal: what is measured is found as without it
            given = None
    names = {plain(given)} if given is not None else {plain(name) for name in (one.channel, *one.names)}
    alike = [(stream, column) for stream, column in every if column.name == one.channel]
    if alike and given is None:
        return alike
    for role in one.roles:
        named = [(s, c) for s, c in every if c.role == role and c.stem and plain(c.stem) in names]
        if not named and given is None:
            named = [
                (s, c) for s, c in every
                if c.role == role and c.by_order and not c.stem and c.width == one.width and c.place == one.place
            ]  # fmt: skip
        if named:
            return named
    return []


def _question(
    one: Wanted,
    candidates: Sequence[tuple[Stream, Column]],
    free: Sequence[tuple[Stream, Column]],
    given: str | None,
    there: Collection[str],
) -> str:
    what = (
        f"{one.channel} ({'what is told' if one.kind == 'input' else 'what is measured'} of {one.names[0]})"
    )
    if len(candidates) > 1:
        richest = max(candidates, key=lambda one: _richness(one[0]))[1]
        names = ", ".join(column.name for _, column in candidates)
        return f"{what}: {names}; proposal: --map {one.channel}={richest.name}"
    if given is not None:
        if plain(given) not in map(plain, there):
            return f"{what}: --map says {given}, and the log has no such column"
        kind = "told" if one.kind == "input" else "measured"
        answers = f"--map {one.channel}=COLUMN, or --map {one.channel}={_NOT} leaves it out"
        return f"{what}: --map says {given}, which is not read as what is {kind}; {answers}"
    columns = [column for _, column in free if column.role in one.roles]
    near = difflib.get_close_matches(plain(one.names[0]), [plain(column.stem) for column in columns], 1, 0.5)
    proposal = next((column for column in columns if near and plain(column.stem) == near[0]), None)
    if proposal is None:
        alone = [c for c in columns if c.place is None and not c.stem and one.width == 1]
        proposal = next((c for c in columns if c.place == one.place and c.width == one.width), None)
        proposal = alone[0] if proposal is None and len(alone) == 1 else proposal
    if proposal is None:  # enc_1, enc_2 ...: numbered in the robot's own order, most likely
        ends = [(_NUMBERED.fullmatch(c.stem), c.name) for c in columns]
        numbered = sorted((int(end["number"]), name) for end, name in ends if end)
        if len(numbered) == one.width and len({end["stem"] for end, _ in ends if end}) == 1:
            by_number = f"--map {one.channel}={numbered[one.place][1]}"
            return f"{what}: no column of that name; proposal, by its number: {by_number}"
    if proposal is None and one.kind == "input":  # two topics of positions: the goals are told by the poorer
        called = [plain(name) for name in one.names]
        twins = [(s, c) for s, c in free if c.role == "position" and plain(c.stem) in called]
        proposal = min(twins, key=lambda twin: _richness(twin[0]))[1] if len(twins) > 1 else None
    if proposal is None:
        return f"{what}: no column of that name; --map {one.channel}={_NOT} leaves it out"
    return f"{what}: no column of that name; proposal: --map {one.channel}={proposal.name}"


def _richness(stream: Stream) -> int:
    """Return how many kinds of things a topic tells: what measures tells velocities and torques as well."""
    return len({column.role for column in stream.columns})


def _listed(wanted: Sequence[Wanted]) -> str:
    return ", ".join(dict.fromkeys(one.channel for one in wanted))


def in_si(matches: Sequence[Match], asked: Unit | None, ticks: int = TICKS) -> tuple[list[Match], list[str]]:
    """Return the matches with their factors to SI, and the units that were found, in words.

    Parameters
    ----------
    asked
        What a person said; told from the range if None.
    ticks
        Of a turn of the encoder.

    Goals and measured angles are each of one unit. What is stated by name or format counts, but for angles that no
    joint can have; then whole numbers of a great range are ticks, angles beyond a turn degrees, others radians. What
    may be shares of the joint's range as well is asked for in a dataset of LeRobot, and told elsewhere.

    Raises
    ------
    RequestError
        The unit cannot be told, or makes angles that the joint cannot have.
    """
    made: list[Match] = []
    said: list[str] = []
    found: dict[str, Unit] = {}
    lerobot = any(
        one.column.name.startswith("observation.state") for one in matches if one.column is not None
    )
    for kind, words in (("output", "measured angles"), ("input", "goals")):
        group = [one for one in matches if one.wanted.kind == kind]
        angles = [one for one in group if one.wanted.unit == "rad" and one.column is not None]
        made += [one for one in group if one not in angles]
        if not angles:
            continue
        unit, reason = (
            (asked, "as --unit says") if asked else _detected(angles, words, ticks, lerobot=lerobot)
        )
        if reason.startswith(_BY_RANGE):
            found[words] = unit
        said.append(f"{words} are in {_WORDS[unit]}{_turn(unit, ticks)}, {reason}")
        made += [
            Match(one.wanted, one.stream, one.column, _factor(unit, one, _largest(angles), ticks))
            for one in angles
        ]
    if len(set(found.values())) > 1:
        told = " and ".join(f"{words} look like {_WORDS[unit]}" for words, unit in found.items())
        raise RequestError(
            f"{told}: a log hardly has both",
            hint="say --unit deg or --unit rad; a small motion in degrees looks like radians",
        )
    said += [told for one in made if one.wanted.kind == "output" and (told := _beyond(one))]
    order = {id(one.wanted): place for place, one in enumerate(matches)}
    return sorted(made, key=lambda one: order[id(one.wanted)]), said


def _beyond(match: Match) -> str:
    """Return a sentence if a joint was measured outside of its range; refuse what lies out by more than all of it."""
    if match.column is None or match.wanted.range is None or not np.isfinite(match.column.values).any():
        return ""
    least, most = (float(one) for one in np.nanquantile(values_of(match), [0.01, 0.99]))
    low, high = match.wanted.range
    out = max(low - least, most - high)
    name, unit = match.wanted.channel, match.wanted.unit
    there = f"{low:.3g} to {high:.3g}"
    told = f"{name} is measured from {least:.3g} to {most:.3g} {unit}, and its range in the model is {there}"
    if out > high - low:
        raise RequestError(
            told, hint="another unit, or another column: --unit, --map; or the model's range is wrong"
        )
    return f"{told}: is the unit right, and the zero?" if out > _OUTSIDE * (high - low) else ""


_OUTSIDE = 0.05
"""Part of its range by which a joint may be measured beyond it without a word: zeros are set by hand."""
_BY_RANGE = "by their range"
_WORDS: Mapping[Unit, str] = {
    "rad": "radians", "deg": "degrees", "ticks": "ticks",
    "normalised": "shares of the joint's range",
}  # fmt: skip


def _turn(unit: Unit, ticks: int) -> str:
    return f" of {ticks} a turn" if unit == "ticks" else ""


def _detected(angles: Sequence[Match], words: str, ticks: int, *, lerobot: bool) -> tuple[Unit, str]:
    columns = [one.column for one in angles if one.column is not None]
    largest = _largest(angles)
    stated = {column.unit for column in columns if column.unit}
    if len(stated) == 1 and not (stated == {"rad"} and largest > _BEYOND_RAD):
        return cast("Unit", stated.pop()), "as the log states"
    if stated == {"rad"}:
        raise RequestError(
            f"{words} reach {largest:.4g}, and are stated to be radians",
            hint="--unit deg, or --unit rad if they are",
        )
    values = [column.values[np.isfinite(column.values)] for column in columns]
    whole = all(bool(np.all(one == np.round(one))) for one in values)
    if whole and largest > 500 and all(one.min(initial=0) >= 0 for one in values):
        if largest >= ticks:
            raise RequestError(
                f"{words} are whole numbers up to {largest:.0f}, more than {ticks} ticks of a turn",
                hint="say how many a turn has: --unit ticks:16384; or --unit rad or deg",
            )
        return "ticks", f"{_BY_RANGE}: whole numbers up to {largest:.0f}"
    if largest <= _BEYOND_RAD:
        doubt = "; a LeRobot dataset does not say its unit: --unit deg or normalised if it is that"
        return "rad", f"{_BY_RANGE}: they reach {largest:.3g}{doubt if lerobot else ''}"
    if largest <= _MOST_SHARE and (lerobot or largest > _FULL_SHARE):
        told = " in a LeRobot dataset, which does not say its unit" if lerobot else ""
        raise RequestError(
            f"{words} reach {largest:.4g}{told}: degrees, or shares of the range from -100 to 100?",
            hint="--unit deg or --unit normalised"
            + ("; use_degrees of the robot's configuration says which" if lerobot else ""),
        )
    if largest <= _MOST_SHARE:
        return "deg", (
            f"{_BY_RANGE}: they reach {largest:.4g}; shares of the joint's range from -100 to 100 look alike: "
            "--unit normalised if they are"
        )
    if largest <= 360 * _SLACK:
        return "deg", f"{_BY_RANGE}: they reach {largest:.4g}"
    raise RequestError(
        f"the unit of {words} cannot be told: they reach {largest:.4g}",
        hint="--unit rad, deg, ticks or normalised",
    )


def _largest(angles: Sequence[Match]) -> float:
    return max(
        float(np.nanmax(np.abs(one.column.values), initial=0.0)) for one in angles if one.column is not None
    )


def _factor(unit: Unit, match: Match, largest: float, ticks: int) -> tuple[float, float]:
    if unit == "rad":
        return 1.0, 0.0
    if unit == "deg":
        return math.pi / 180, 0.0
    if unit == "ticks":
        return 2 * math.pi / ticks, -math.pi
    if match.wanted.range is None:
        raise RequestError(
            f"{match.wanted.names[0]} has no range in the model, of which a normalised angle would be a share",
            hint="give the joint a range, or convert the log",
        )
    low, high = match.wanted.range
    full = 100.0 if largest > 1.5 else 1.0
    return (high - low) / (2 * full), 0.5 * (low + high)


def values_of(match: Match) -> FloatArray:
    """Return the values of a match in the model's unit."""
    if match.column is None:
        raise ValueError("this channel has no column")
    factor, offset = match.to_si
    return factor * match.column.values + offset
