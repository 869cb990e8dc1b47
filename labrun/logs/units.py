"""In which unit each column is: as stated, as asked, or by the ranges of all joints together."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.logs.findings import Finding, Question, Statement
from labrun.logs.matching import Match, Wanted
from labrun.logs.streams import plain
from labrun.logs.turns import without_jumps

Unit = Literal["rad", "deg", "ticks", "normalised", "percent", "m", "mm", "N m", "mN m", "A", "mA"]
TICKS = 4096
"""Steps of an encoder in one turn, its middle being zero, if nobody says: that of servos whose logs come in ticks."""
_LEAST_TICKS = 500.0
"""Whole numbers above this are ticks of an encoder: degrees of a joint stay below it, and have digits."""
_BEYOND_RAD = 2.2 * math.pi
_SLACK = 1.05
_FULL_SHARE, _MOST_SHARE = 99.0, 100.5
"""What shares of a joint's range reach if all of it was used, and at most with rounding."""
_OUTSIDE = 0.05
"""Part of its range by which a joint may be measured beyond it without a word: zeros are set by hand."""
_GRIPPER = re.compile(r"(?i)gripper|jaw|finger|claw|hand")
_WORDS: Mapping[str, str] = {
    "rad": "radians", "deg": "degrees", "ticks": "ticks", "normalised": "shares of the joint's range",
    "percent": "percent of the joint's range", "m": "metres", "mm": "millimetres", "N m": "N m", "mN m": "mN m",
    "A": "amperes", "mA": "milliamperes", "deg/s": "degrees a second", "N": "N",
}  # fmt: skip
_ANGLES, _TORQUES = ("rad", "m"), ("N m", "N")


@dataclass(frozen=True)
class AskedUnits:
    """What a person said with ``--unit`` and ``--zero``.

    Attributes
    ----------
    units : name of a joint or channel -> unit and its number (ticks a turn, N m per ampere)
        "" stands for all angles.
    zeros : name of a joint -> its zero in the unit of the log
    """

    units: Mapping[str, tuple[str, float | None]]
    zeros: Mapping[str, float]

    @classmethod
    def parsed(cls, units: Sequence[str], zeros: Sequence[str]) -> "AskedUnits":
        """Return what ``deg``, ``gripper=percent``, ``ticks:16384`` and ``shoulder=2048`` say.

        Raises RequestError: a text says no unit, or no number.
        """
        asked: dict[str, tuple[str, float | None]] = {}
        for text in units:
            name, equals, value = text.rpartition("=")
            unit, colon, number = value.partition(":")
            size = _positive(number) if colon else None
            takes = unit == "ticks" or unit in ("A", "mA")
            if unit not in get_args(Unit) or (colon and (size is None or not takes)) or (equals and not name):
                raise RequestError(
                    f"{text!r} is no unit of angles", hint=f"one of {', '.join(get_args(Unit))}, ticks:16384, or "
                    "gripper=percent for one joint, shoulder_torque=A:0.9 for a torque of 0.9 N m per ampere",
                )  # fmt: skip
            asked[plain(name)] = unit, size
        numbers: dict[str, float] = {}
        for text in zeros:
            name, equals, value = text.rpartition("=")
            try:
                numbers[plain(name)] = float(value)
            except ValueError:
                equals = ""
            if not equals:
                raise RequestError(
                    f"--zero {text}: a joint and a number were expected", hint="--zero shoulder=2048"
                )
        return cls(asked, numbers)

    def of(self, wanted: Wanted) -> tuple[str, float | None] | None:
        """Return the unit of a channel that was stated for it or for all."""
        names = (wanted.channel, *wanted.names)
        own = next((self.units[plain(name)] for name in names if plain(name) in self.units), None)
        fits = (*_ANGLES_UNITS, *(_TORQUE_UNITS if plain(wanted.channel) in self.units else ()))
        if wanted.unit in _TORQUES:
            fits = _TORQUE_UNITS
        own = own if own is not None and own[0] in fits else None
        return own or (self.units.get("") if wanted.unit == "rad" else None)

    def require_known(self, wanted: Sequence[Wanted]) -> None:
        """Raise RequestError if a name is no joint or channel of the model."""
        known = {plain(name) for channel in wanted for name in (channel.channel, *channel.names)}
        for flag, names in (("--unit", self.units), ("--zero", self.zeros)):
            for name in names:
                if name and name not in known:
                    joints = ", ".join(dict.fromkeys(channel.names[0] for channel in wanted))
                    raise RequestError(
                        f"{flag} {name}=...: the model has no {name!r}", hint=f"it has {joints}"
                    )


_ANGLES_UNITS = ("rad", "deg", "ticks", "normalised", "percent", "m", "mm")
_BY_RANGE = "by their range"
_PROPOSED = "as proposed until it is answered"
_TORQUE_UNITS = ("N m", "mN m", "A", "mA")


def _positive(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) and number > 0 else None


@dataclass(frozen=True)
class _Joint:
    """All that the logs tell of the position of one joint: goals and measurements."""

    name: str
    matches: tuple[Match, ...]

    @property
    def range(self) -> tuple[float, float] | None:
        return self.matches[0].wanted.range

    def values(self, kind: str | None = None, *, unwrapped: bool = True) -> FloatArray:
        """Return all numbers of the joint; `unwrapped`: where an angle wrapped at a whole turn, as if it had not."""
        own = [
            match.column.values[np.isfinite(match.column.values)]
            for match in self.matches
            if match.column is not None and kind in (None, match.wanted.kind)
        ]
        if unwrapped and self.matches[0].wanted.unit == "rad":
            own = [without_jumps(without_jumps(values, 2 * math.pi), 360.0) for values in own]
        return np.concatenate(own) if own else np.empty(0)

    def largest(self, kind: str | None = None) -> float:
        return float(np.max(np.abs(self.values(kind)), initial=0.0))

    def excess(self, factor: float) -> float:
        """Return by how much of its range the joint goes beyond it in a unit of so many radians."""
        values = self.values()
        if self.range is None or not len(values):
            return 0.0
        low, high = self.range
        least, most = (factor * float(end) for end in np.quantile(values, [0.01, 0.99]))
        return max(low - least, most - high, 0.0) / (high - low)


def decide_units(
    logs: Sequence[Sequence[Match]], asked: AskedUnits, *, currents_stay: bool = False
) -> tuple[list[list[Match]], list[Finding]]:
    """Return the matches of every log with their units and factors to SI, and what was found.

    What a person says counts first, then what the column states. What is open is decided with the ranges of all joints
    of all logs: whole numbers of a great range are ticks, angles beyond a turn degrees unless the joint whirls, others
    radians. What the ranges leave in doubt is asked.

    Parameters
    ----------
    currents_stay
        Whether the torque per ampere is found later: motor currents are then taken in amperes. Otherwise it is asked.
    """
    asked.require_known([match.wanted for matches in logs for match in matches])
    matches = [match for log in logs for match in log if match.column is not None]
    joints = _joints([match for match in matches if match.wanted.unit in _ANGLES])
    units: dict[str, tuple[str, float | None, str]] = {}
    findings: list[Finding] = []
    open_: list[_Joint] = []
    for joint in joints:
        stated_unit = next((unit for match in joint.matches if (unit := asked.of(match.wanted))), None)
        stated = {
            match.column.unit for match in joint.matches if match.column is not None and match.column.unit
        }
        stated &= set(_ANGLES_UNITS)
        own = any(plain(name) in asked.units for match in joint.matches for name in _names(match.wanted))
        # what is said of all angles is not said of a gripper that its data set states to be in percent
        if stated_unit is not None and (own or stated != {"percent"}):
            units[joint.name] = *stated_unit, "as --unit says"
        elif len(stated) == 1:
            units[joint.name] = *_stated(joint, stated.pop(), findings), "as the log states"
        else:
            open_.append(joint)
    hinges = [joint for joint in open_ if joint.matches[0].wanted.unit == "rad"]
    for joint in [joint for joint in open_ if joint not in hinges]:
        units[joint.name] = _slide(joint, findings)
    grippers = _grippers(hinges, findings)
    units |= grippers
    hinges = [joint for joint in hinges if joint.name not in grippers]
    if hinges:
        units |= dict.fromkeys([joint.name for joint in hinges], _by_range(hinges, findings))
    made = [
        [_converted(match, units, asked, findings, currents_stay=currents_stay) for match in log]
        for log in logs
    ]
    findings += _currents(made)
    return made, list(dict.fromkeys([*_summaries(made, asked), *findings]))


def check_ranges(logs: Sequence[Sequence[Match]]) -> list[Finding]:
    """Return what is said and asked of joints that were measured outside of their range in the model."""
    names = dict.fromkeys(match.wanted.names[0] for log in logs for match in log)
    return [finding for name in names for finding in _beyond(name, logs)]


def _names(wanted: Wanted) -> tuple[str, ...]:
    return (wanted.channel, *wanted.names)


def _joints(matches: Sequence[Match]) -> list[_Joint]:
    groups: dict[str, list[Match]] = {}
    for match in matches:
        groups.setdefault(match.wanted.names[0], []).append(match)
    return [_Joint(name, tuple(group)) for name, group in groups.items()]


def _stated(joint: _Joint, unit: str, findings: list[Finding]) -> tuple[str, float | None]:
    """Return the stated unit; angles that no joint with a range has are asked about."""
    if unit == "rad" and joint.largest() > _BEYOND_RAD and joint.excess(1.0) > _OUTSIDE:
        findings.append(
            Question(
                f"{joint.name} reaches {joint.largest():.4g}, and is stated to be in radians",
                proposal=f"--unit {joint.name}=deg",
                answers=f"--unit {joint.name}=rad if it is",
                channel=joint.name,
            )
        )
    return unit, None


def _slide(joint: _Joint, findings: list[Finding]) -> tuple[str, float | None, str]:
    """Return the unit of a slide: metres, unless it then leaves its range."""
    if joint.excess(1.0) <= 1.0:
        return "m", None, _BY_RANGE if joint.range else "as nothing else is stated"
    values = joint.values()
    percent = values.min() >= -0.5 and values.max() <= _MOST_SHARE
    unit = (
        "percent"
        if (percent and joint.excess(1e-3) > _OUTSIDE) or (_GRIPPER.search(joint.name) and percent)
        else "mm"
    )
    low, high = joint.range or (0.0, 0.0)
    findings.append(
        Question(
            f"{joint.name} runs from {values.min():.4g} to {values.max():.4g}, and its range in the model is "
            f"{low:.3g} to {high:.3g} m",
            proposal=f"--unit {joint.name}={unit}",
            answers=f"--unit {joint.name}=percent, mm or m",
            channel=joint.name,
        )
    )
    return unit, None, _PROPOSED


def _grippers(joints: Sequence[_Joint], findings: list[Finding]) -> dict[str, tuple[str, float | None, str]]:
    """Return the units of grippers that run from 0 to 100 beside joints in another unit."""
    units: dict[str, tuple[str, float | None, str]] = {}
    for joint in joints:
        values = joint.values()
        if (
            len(joints) < 2
            or not _GRIPPER.search(joint.name)
            or not len(values)
            or joint.largest() <= _BEYOND_RAD
        ):
            continue
        if values.min() < -0.5 or values.max() > _MOST_SHARE:
            continue
        others = max(other.largest() for other in joints if other is not joint)
        findings.append(
            Question(
                f"{joint.name} runs from {values.min():.4g} to {values.max():.4g}, the other joints reach {others:.4g}"
                ": percent of its range, or their unit?",
                proposal=f"--unit {joint.name}=percent",
                answers=f"--unit {joint.name}=deg",
                channel=joint.name,
            )
        )
        units[joint.name] = "percent", None, _PROPOSED
    return units


def _by_range(joints: Sequence[_Joint], findings: list[Finding]) -> tuple[str, float | None, str]:
    """Return the one unit of joints that state none, with the evidence of all of them."""
    sides = {kind: max(joint.largest(kind) for joint in joints) for kind in ("output", "input")}
    largest = max(sides.values())
    counts = np.concatenate([joint.values(unwrapped=False) for joint in joints])
    if (
        counts.max(initial=0.0) > _LEAST_TICKS
        and counts.min() >= 0
        and np.array_equal(counts, np.round(counts))
    ):
        return _ticks(float(counts.max()), findings)
    lerobot = any(
        match.stream is not None and match.stream.lerobot for joint in joints for match in joint.matches
    )
    if largest <= _BEYOND_RAD:
        doubt = "; a LeRobot data set does not say its unit: --unit deg or normalised if it is that"
        return "rad", None, f"{_BY_RANGE}: they reach {largest:.3g}{doubt if lerobot else ''}"
    doubts = (
        _of_two_units(joints, sides), _whirling(joints), _perhaps_shares(largest, lerobot=lerobot),
        _beyond_degrees(joints, largest),
    )  # fmt: skip
    question = next((doubt for doubt in doubts if doubt is not None), None)
    if question is not None:
        findings.append(question)
        return (question.proposal or "--unit deg").rpartition(" ")[2], None, _PROPOSED
    if largest > _MOST_SHARE:
        return "deg", None, f"{_BY_RANGE}: they reach {largest:.4g}"
    return "deg", None, (
        f"{_BY_RANGE}: they reach {largest:.4g}; shares of the joint's range from -100 to 100 look alike: "
        "--unit normalised if they are"
    )  # fmt: skip


def _ticks(largest: float, findings: list[Finding]) -> tuple[str, float, str]:
    """Return the ticks of a turn; asked where there are more of them than servos have."""
    if largest < TICKS:
        return "ticks", TICKS, f"{_BY_RANGE}: whole numbers up to {largest:.0f}"
    size = 2 ** math.ceil(math.log2(largest + 1))
    findings.append(
        Question(
            f"angles are whole numbers up to {largest:.0f}, more than {TICKS} ticks of a turn: how many has one?",
            proposal=f"--unit ticks:{size}",
            answers=f"--unit ticks:{TICKS} if a joint turned several times; --unit rad or deg",
        )
    )
    return "ticks", float(size), _PROPOSED


def _of_two_units(joints: Sequence[_Joint], sides: Mapping[str, float]) -> Question | None:
    """Return a question if goals look like degrees beside measurements like radians, or the other way round."""
    words = {"output": "measured angles", "input": "goals"}
    small = [kind for kind, side in sides.items() if 0.0 < side <= _BEYOND_RAD]
    if not small or any(joint.excess(math.pi / 180) > _OUTSIDE for joint in joints):
        return None
    other = "input" if small[0] == "output" else "output"
    return Question(
        f"{words[small[0]]} look like radians and {words[other]} look like degrees (they reach "
        f"{sides[small[0]]:.3g} and {sides[other]:.4g}): a log hardly has both; little motion in degrees looks alike",
        proposal="--unit deg",
        answers="--unit rad",
    )


def _perhaps_shares(largest: float, *, lerobot: bool) -> Question | None:
    """Return a question if angles may be shares of the range: they use all of it, or are of LeRobot."""
    if largest > _MOST_SHARE or not (lerobot or largest > _FULL_SHARE):
        return None
    of = " in a LeRobot data set, which does not say its unit" if lerobot else ""
    return Question(
        f"angles reach {largest:.4g}{of}: degrees, or shares of the range from -100 to 100?"
        + (" use_degrees of the robot's configuration says which" if lerobot else ""),
        proposal=f"--unit {'normalised' if lerobot and largest > _FULL_SHARE else 'deg'}",
        answers="--unit deg or --unit normalised",
    )


def _beyond_degrees(joints: Sequence[_Joint], largest: float) -> Question | None:
    """Return a question if joints with a range go further than a turn in degrees."""
    if max((joint.largest() for joint in joints if joint.range is not None), default=largest) <= 360 * _SLACK:
        return None
    return Question(
        f"the unit of the angles cannot be told: {_evidence(joints)}",
        answers="--unit rad, deg, ticks or normalised",
    )


def _whirling(joints: Sequence[_Joint]) -> Question | None:
    """Return a question if joints without a range turn far, and all others fit radians as well as degrees."""
    far = [joint for joint in joints if joint.largest() > _BEYOND_RAD]
    near = [joint for joint in joints if joint not in far and joint.largest() > 0.0]
    if (
        not near
        or any(joint.range is not None for joint in far)
        or any(joint.excess(1.0) > _OUTSIDE for joint in near)
    ):
        return None
    unit = "rad" if len(far) <= len(near) else "deg"
    return Question(
        f"radians with {', '.join(joint.name for joint in far)} turning several times, or degrees of little motion? "
        f"{_evidence(joints)}", proposal=f"--unit {unit}", answers=f"--unit {'deg' if unit == 'rad' else 'rad'}",
    )  # fmt: skip


def _evidence(joints: Sequence[_Joint]) -> str:
    """Return how far each joint reaches, and its range in the model."""
    return "; ".join(
        f"{joint.name} reaches {joint.largest():.4g}"
        + (f" of {joint.range[0]:.3g} to {joint.range[1]:.3g} rad" if joint.range else ", without a range")
        for joint in joints[:12]
    )


def _converted(
    match: Match,
    units: Mapping[str, tuple[str, float | None, str]],
    asked: AskedUnits,
    findings: list[Finding],
    *,
    currents_stay: bool,
) -> Match:
    wanted, column = match.wanted, match.column
    if column is None:
        return match
    if wanted.unit in _ANGLES:
        unit, size, why = units[wanted.names[0]]
        if unit in ("normalised", "percent") and wanted.range is None:
            findings.append(
                Question(
                    f"{wanted.names[0]} has no range in the model, of which an angle in {_WORDS[unit]} would be a part",
                    answers="give the joint a range in the model, or convert the log",
                    channel=wanted.channel,
                )
            )
            return replace(match, unit=unit, why=why)
        factor, offset, turn = _angle_scale(unit, size, match, asked)
        return replace(match, to_si=(factor, offset), unit=unit, why=why, turn=turn)
    if wanted.unit == "rad/s":
        joint = units.get(wanted.names[0])
        if column.unit == "deg/s" or (joint is not None and joint[0] == "deg" and column.unit == ""):
            why = "as the log states" if column.unit else "as the angles of its joint"
            return replace(match, to_si=(math.pi / 180, 0.0), unit="deg/s", why=why)
    if wanted.unit in _TORQUES:
        return _torque(match, asked, findings, currents_stay=currents_stay)
    return replace(
        match,
        unit=column.unit or wanted.unit,
        why="as the model states" if not column.unit else "as the log states",
    )


def _angle_scale(
    unit: str, size: float | None, match: Match, asked: AskedUnits
) -> tuple[float, float, float | None]:
    """Return factor, offset and the length of a turn of an angle's unit."""
    wanted = match.wanted
    low, high = wanted.range or (0.0, 0.0)
    full = (
        100.0
        if match.column is not None and float(np.nanmax(np.abs(match.column.values), initial=0.0)) > 1.5
        else 1.0
    )
    scales: dict[str, tuple[float, float, float | None]] = {
        "rad": (1.0, 0.0, 2 * math.pi), "deg": (math.pi / 180, 0.0, 360.0),
        "ticks": (2 * math.pi / (size or TICKS), -math.pi, size or TICKS),
        "normalised": ((high - low) / (2 * full), 0.5 * (low + high), None),
        "percent": ((high - low) / 100.0, low, None), "m": (1.0, 0.0, None), "mm": (1e-3, 0.0, None),
    }  # fmt: skip
    factor, offset, turn = scales[unit]
    names = (wanted.channel, *wanted.names)
    zero = next((asked.zeros[plain(name)] for name in names if plain(name) in asked.zeros), None)
    return factor, offset if zero is None else -factor * zero, turn if wanted.unit == "rad" else None


def _torque(match: Match, asked: AskedUnits, findings: list[Finding], *, currents_stay: bool) -> Match:
    """Return a torque with its scale: amperes are none, and need the torque constant, or stay amperes."""
    wanted, column = match.wanted, match.column
    unit, size = asked.of(wanted) or ("", None)
    stated = unit or (column.unit if column is not None and column.unit in _TORQUE_UNITS else "")
    if not stated and column is not None and column.role == "current":
        stated = "A"
    why = "as --unit says" if unit else "as the log states"
    if stated in ("A", "mA"):
        if size is None and currents_stay:
            wanted = replace(wanted, unit="A")
        elif size is None:
            findings.append(
                Question(
                    f"{wanted.channel}: {column.name if column else ''} is a current, and amperes are not N m",
                    answers="state the torque per ampere at the joint, gear included: "
                    f"--unit {wanted.channel}={stated}:0.9; --map {wanted.channel}=none leaves it out",
                    channel=wanted.channel,
                )
            )
        return replace(
            match,
            wanted=wanted,
            to_si=((1e-3 if stated == "mA" else 1.0) * (size or 1.0), 0.0),
            unit=stated,
            why=why,
        )
    if stated == "mN m":
        return replace(match, to_si=(1e-3, 0.0), unit=stated, why=why)
    return replace(match, unit=stated or wanted.unit, why=why if stated else "as nothing else is stated")


def _currents(logs: Sequence[Sequence[Match]]) -> list[Finding]:
    """Return which channels stay motor currents, and what becomes of them."""
    names = dict.fromkeys(match.wanted.channel for log in logs for match in log if match.wanted.unit == "A")
    if not names:
        return []
    return [
        Statement(
            f"motor currents, in amperes: {', '.join(names)}; the diagnosis finds the torque per ampere from the "
            f"stated masses; --unit {next(iter(names))}=A:0.9 states it (N m per ampere at the joint, gear included)"
        )
    ]


def _summaries(logs: Sequence[Sequence[Match]], asked: AskedUnits) -> list[Finding]:
    """Return the units of goals and of what is measured, those of all joints in one sentence where they agree."""
    findings: list[Finding] = []
    for kind, words in (("output", "measured angles"), ("input", "goals")):
        angles = [
            match for log in logs for match in log
            if match.wanted.kind == kind and match.wanted.unit in _ANGLES and match.column is not None
        ]  # fmt: skip
        groups: dict[tuple[str, str, float | None], list[str]] = {}
        for match in angles:
            groups.setdefault((match.unit, match.why, match.turn), []).append(match.wanted.names[0])
        for (unit, why, turn), names in groups.items():
            of = "" if len(groups) == 1 else f" of {', '.join(dict.fromkeys(names))}"
            middle = [name for name in dict.fromkeys(names) if plain(name) not in asked.zeros]
            ticks = f" of {turn:.0f} a turn" if unit == "ticks" and turn else ""
            zero = f" with zero in the middle (--zero {middle[0]}=TICKS if not)" if ticks and middle else ""
            findings.append(Statement(f"{words}{of} are in {_WORDS[unit]}{ticks}{zero}, {why}"))
    findings += [
        Statement(f"{match.wanted.channel} is in {_WORDS[match.unit]}, {match.why}", match.wanted.channel)
        for log in logs
        for match in log
        if match.unit in ("A", "mA", "mN m", "deg/s") and match.wanted.unit != "A"
    ]
    return findings


def _beyond(joint: str, logs: Sequence[Sequence[Match]]) -> list[Finding]:
    """Return what is said or asked where a joint was measured outside of its range in the model."""
    for match in (match for log in logs for match in log):
        wanted = match.wanted
        if (
            wanted.names[0] != joint
            or wanted.kind != "output"
            or match.column is None
            or wanted.range is None
        ):
            continue
        values = match.in_si()
        if not np.isfinite(values).any():
            continue
        least, most = (float(end) for end in np.nanquantile(values, [0.01, 0.99]))
        low, high = wanted.range
        out = max(low - least, most - high)
        text = (
            f"{wanted.channel} is measured from {least:.3g} to {most:.3g} {wanted.unit}, and its range in the model is "
            f"{low:.3g} to {high:.3g}"
        )
        if out > high - low:
            answers = "another unit, zero or column (--unit, --zero, --map); or the model's range is wrong"
            return [Question(text, answers=answers, channel=wanted.channel)]
        if out > _OUTSIDE * (high - low):
            return [Statement(f"{text}: is the unit right, and the zero?", wanted.channel)]
    return []
