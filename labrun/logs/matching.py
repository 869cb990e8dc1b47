"""Which column of a log is which input or output of a model: certain by its name, or asked for."""

import difflib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.logs.findings import Finding, Question, Statement
from labrun.logs.streams import Column, Role, Stream, plain

_NUMBERED = re.compile(r"(?P<stem>\D*)(?P<number>\d+)")
_COMMANDS = ("command", "velocity-command", "torque-command")
NOT = "none"
"""What ``--map`` says of a channel that the log does not have."""


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
        What a log may call it; the first is the joint's or the channel's own.
    roles
        What its column may be, most likely first.
    index, width
        Which one of how many it is, in the robot's own order.
    range
        What the joint can do, in `unit`; None where it can turn without end, or nobody says.
    """

    channel: str
    unit: str
    kind: Literal["input", "output"]
    names: tuple[str, ...]
    roles: tuple[Role, ...]
    index: int = 0
    width: int = 1
    range: tuple[float, float] | None = None

    @property
    def goal(self) -> bool:
        """Tell whether it is a goal, which stands until the next one."""
        return self.kind == "input" and self.roles[0] in ("command", "velocity-command")


@dataclass(frozen=True, eq=False)
class Match:
    """A wanted channel and its column; None where the log has none, and a person said so.

    Attributes
    ----------
    to_si
        Factor and offset to the model's unit.
    unit, why
        What the column is in, and how that is known; "" before it was asked.
    turn
        One turn of the joint in the column's unit; None where it does not turn.
    """

    wanted: Wanted
    stream: Stream | None
    column: Column | None
    to_si: tuple[float, float] = (1.0, 0.0)
    unit: str = ""
    why: str = ""
    turn: float | None = None

    def in_si(self) -> FloatArray:
        """Return the values in the model's unit."""
        if self.column is None:
            raise ValueError("this channel has no column")
        factor, offset = self.to_si
        return factor * self.column.values + offset


def matched(
    wanted: Sequence[Wanted], streams: Sequence[Stream], asked: Mapping[str, str]
) -> tuple[list[Match], list[Finding]]:
    """Return each wanted channel's column, with what is in doubt; a proposal stands in for an answer.

    Parameters
    ----------
    asked
        What a person said with ``--map``: a channel or joint to a column, its stem, or ``none``.

    Raises
    ------
    RequestError
        ``--map`` names what the model does not have.
    """
    known = {plain(name) for channel in wanted for name in (channel.channel, *channel.names)}
    for name in asked:
        if plain(name) not in known:
            channels = ", ".join(dict.fromkeys(channel.channel for channel in wanted))
            raise RequestError(f"--map {name}=...: the model has no {name!r}", hint=f"it has {channels}")
    matches: list[Match] = []
    open_: list[tuple[Wanted, list[tuple[Stream, Column]], str | None]] = []
    findings: list[Finding] = []
    for channel in wanted:
        given = asked_for(channel, asked)
        if given == NOT:
            matches.append(Match(channel, None, None))
            continue
        exact = plain(channel.channel) in {plain(name) for name in asked}
        candidates = _candidates(channel, streams, given, exact=exact)
        if len(candidates) != 1:
            open_.append((channel, candidates, given))
            continue
        matches.append(Match(channel, *candidates[0]))
        column = candidates[0][1]
        if given is not None and plain(given) in map(plain, (column.name, column.stem)):
            findings.append(Statement(f"{channel.channel} is {column.name}, as --map says", channel.channel))
    taken = {id(match.column) for match in matches}
    free = [(stream, column) for stream in streams for column in stream.columns if id(column) not in taken]
    names = sorted({column.name for stream in streams for column in stream.columns})
    for channel, candidates, given in open_:
        question, proposal = _question(channel, candidates, free, given, names)
        findings.append(question)
        matches.append(Match(channel, *proposal) if proposal else Match(channel, None, None))
    findings += _twice(matches)
    order = {channel.channel: index for index, channel in enumerate(wanted)}
    return sorted(matches, key=lambda match: order[match.wanted.channel]), findings


def unused(matches: Sequence[Match], streams: Sequence[Stream]) -> list[Finding]:
    """Return what the log holds of goals, torques and currents that no channel takes."""
    taken = {id(match.column) for match in matches if match.column is not None}
    roles = (*_COMMANDS, "torque", "current")
    names = [
        column.name
        for stream in streams
        for column in stream.columns
        if column.role in roles and id(column) not in taken
    ]
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return [Statement(f"not used: {', '.join(names[:12])}{more}")] if names else []


def asked_for(channel: Wanted, asked: Mapping[str, str]) -> str | None:
    """Return what a person said of a channel, by its own name or its joint's."""
    by_plain = {plain(name): value for name, value in asked.items()}
    return next(
        (by_plain[plain(name)] for name in (channel.channel, *channel.names) if plain(name) in by_plain), None
    )


def _twice(matches: Sequence[Match]) -> list[Finding]:
    """Return a question for every column that was taken for more than one channel."""
    channels: dict[int, list[str]] = {}
    names: dict[int, str] = {}
    for match in matches:
        if match.column is not None:
            channels.setdefault(id(match.column), []).append(match.wanted.channel)
            names[id(match.column)] = match.column.name
    return [
        Question(
            f"{' and '.join(several)}: column {names[key]} was taken for all of them, and can be one only",
            answers=f"--map {several[0]}=COLUMN, or --map {several[0]}={NOT}",
        )
        for key, several in channels.items()
        if len(several) > 1
    ]


def _candidates(
    channel: Wanted, streams: Sequence[Stream], given: str | None, *, exact: bool
) -> list[tuple[Stream, Column]]:
    pairs = [(stream, column) for stream in streams for column in stream.columns]
    if given is not None:
        whole = [(stream, column) for stream, column in pairs if plain(column.name) == plain(given)]
        # --map pan=/cmd[0] is about the goal of pan where /cmd says that it is one
        measured = channel.kind == "output"
        fitting = [
            (stream, column)
            for stream, column in whole
            if column.role in channel.roles or (exact and not (measured and column.role in _COMMANDS))
        ]
        if fitting:
            return fitting
        if (
            whole
        ):  # --map shoulder=/cmd/shoulder is about the goal: what is measured is looked for as without it
            given = None
    names = (
        {plain(given)} if given is not None else {plain(name) for name in (channel.channel, *channel.names)}
    )
    alike = [(stream, column) for stream, column in pairs if column.name == channel.channel]
    if alike and given is None:
        return alike
    for role in channel.roles:
        named = [(s, c) for s, c in pairs if c.role == role and c.stem and plain(c.stem) in names]
        if not named and given is None:
            named = [
                (s, c) for s, c in pairs
                if c.role == role and c.by_order and not c.stem and c.width == channel.width
                and c.index == channel.index
            ]  # fmt: skip
        if named:
            return named
    return []


def _question(
    channel: Wanted,
    candidates: Sequence[tuple[Stream, Column]],
    free: Sequence[tuple[Stream, Column]],
    given: str | None,
    names: Collection[str],
) -> tuple[Question, tuple[Stream, Column] | None]:
    """Return what is asked about a channel, and the column that stands in until it is answered."""
    what = (
        f"{channel.channel} ({'what is told' if channel.kind == 'input' else 'what is measured'} "
        f"of {channel.names[0]})"
    )

    def proposed(text: str, pair: tuple[Stream, Column]) -> tuple[Question, tuple[Stream, Column]]:
        return Question(
            f"{what}: {text}", f"--map {channel.channel}={pair[1].name}", channel=channel.channel
        ), pair

    def without(text: str, answers: str) -> tuple[Question, None]:
        return Question(f"{what}: {text}", answers=answers, channel=channel.channel), None

    if len(candidates) > 1:
        own = plain(channel.names[0])
        richest = max(candidates, key=lambda pair: (_richness(pair[0]), plain(pair[1].stem) == own))
        return proposed(", ".join(column.name for _, column in candidates), richest)
    leaves_out = f"--map {channel.channel}={NOT} leaves it out"
    if given is not None:
        if plain(given) not in map(plain, names):
            return without(f"--map says {given}, and the log has no such column", leaves_out)
        kind = "told" if channel.kind == "input" else "measured"
        return without(
            f"--map says {given}, which is not read as what is {kind}; --map {channel.channel}=COLUMN",
            leaves_out,
        )
    pair = _proposal(channel, free)
    if pair is None:
        return without("no column of that name", leaves_out)
    return proposed("no column of that name", pair)


def _proposal(channel: Wanted, free: Sequence[tuple[Stream, Column]]) -> tuple[Stream, Column] | None:
    """Return the column that a channel most likely is: by a name that is alike, its index, or its number."""
    pairs = [(stream, column) for stream, column in free if column.role in channel.roles]
    stems = [plain(column.stem) for _, column in pairs]
    near = difflib.get_close_matches(plain(channel.names[0]), stems, 1, 0.5)
    if near:
        return pairs[stems.index(near[0])]
    alone = [pair for pair in pairs if pair[1].index is None and not pair[1].stem and channel.width == 1]
    placed = next((p for p in pairs if p[1].index == channel.index and p[1].width == channel.width), None)
    if placed is not None or len(alone) == 1:
        return placed or alone[0]
    by_number = numbered(channel.index, channel.width, pairs)
    if by_number is not None:
        return by_number
    if channel.kind == "input":  # two topics of positions: the goals are told by the poorer
        called = [plain(name) for name in channel.names]
        twins = [pair for pair in free if pair[1].role == "position" and plain(pair[1].stem) in called]
        if len(twins) > 1:
            return min(twins, key=lambda pair: _richness(pair[0]))
    return None


def numbered(offset: int, width: int, pairs: Sequence[tuple[Stream, Column]]) -> tuple[Stream, Column] | None:
    """Return the column of a offset where all of them are numbered, most likely in the robot's own order."""
    ends = [(_NUMBERED.fullmatch(column.stem), pair) for pair in pairs for column in (pair[1],)]
    order = sorted(
        ((int(end["number"]), index) for index, (end, _) in enumerate(ends) if end), key=lambda pair: pair[0]
    )
    if len(order) != width or len({end["stem"] for end, _ in ends if end}) != 1:
        return None
    return ends[order[offset][1]][1]


def _richness(stream: Stream) -> int:
    """Return how many kinds of things a topic tells: what measures tells velocities and torques as well."""
    return len({column.role for column in stream.columns})
