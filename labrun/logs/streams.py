"""What every reader returns: streams of named columns over time, and what the name of a column says of it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.logs.findings import Finding, Statement

Role = Literal[
    "position", "velocity", "torque", "current", "command", "velocity-command", "torque-command", "unknown"
]
_WORDS: dict[str, frozenset[str]] = {
    "command": frozenset((
        "cmd", "cmds", "command", "commands", "commanded", "goal", "goals", "target", "targets", "ref", "reference",
        "references", "desired", "des", "setpoint", "setpoints", "sp", "action", "actions", "ctrl", "control",
    )),
    "velocity": frozenset(("vel", "velocity", "velocities", "qvel", "dq", "speed", "rate")),
    "torque": frozenset(("torque", "torques", "effort", "efforts", "tau")),
    "current": frozenset(("current", "currents", "amp", "amps", "ampere", "amperes", "iq")),
    "position": frozenset((
        "pos", "position", "positions", "qpos", "q", "angle", "angles", "state", "states", "actual", "measured", "meas",
        "feedback", "encoder", "enc",
    )),
    "acceleration": frozenset(("acc", "acceleration", "accelerations", "qacc", "ddq")),
    "present": frozenset(("present",)),
}  # fmt: skip
_ANY_ROLE = frozenset().union(*_WORDS.values())
UNIT_WORDS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "rad": "rad", "radian": "rad", "radians": "rad",
    "ticks": "ticks", "counts": "ticks", "normalized": "normalised", "normalised": "normalised", "percent": "percent",
    "%": "percent", "mm": "mm", "a": "A", "ma": "mA", "nm": "N m", "n m": "N m", "n*m": "N m", "n·m": "N m",
    "mnm": "mN m", "m": "m", "n": "N", "rad/s": "rad/s", "deg/s": "deg/s", "m/s": "m/s", "s": "s", "sec": "s",
    "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns",
}  # fmt: skip
"""How a bracket in a header or a row of units calls what."""
_NAME_UNITS = {word: unit for word, unit in UNIT_WORDS.items() if len(word) > 2 and word.isalpha()} | {
    "ma": "mA"
}
_SPLIT = re.compile(r"[^A-Za-z0-9]+|(?<=[a-z])(?=[A-Z])")
_BRACKETED = re.compile(r"^(.*?)\s*[\[(<]\s*([^\])>]*?)\s*[\])>]\s*$")
_NUMBERED_WORD = re.compile(r"([A-Za-z]+)(\d+)")
_EPISODE_COLUMNS = (
    "episode_index", "episode", "episode_id", "episode_number", "trial", "trial_index", "trial_id", "trial_number",
    "demo", "rollout",
)  # fmt: skip
SAME_ROWS = 0.95
"""Columns that share this part of their rows share their stamps; what lacks is a lost sample, not a rate of its own."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a log.

    Attributes
    ----------
    name
        Whole, as the log has it: ``/joint_states/position/shoulder``.
    stem
        What is left of it without words of its role: ``shoulder``; "" for a nameless part of a vector.
    role
        What its name says it is.
    values : (n,)
        Not a number where the log has none.
    unit
        That its format, its header or its name states; "" for none.
    index, width
        Which part of a vector of how many it is; None where it stands alone.
    by_order
        Whether the vector's order is the robot's own, as MuJoCo's ``qpos`` and ``ctrl``.
    """

    name: str
    stem: str
    role: Role
    values: FloatArray
    unit: str = ""
    index: int | None = None
    width: int | None = None
    by_order: bool = False


@dataclass(frozen=True, eq=False)
class Stream:
    """Columns that share their stamps.

    Attributes
    ----------
    time_s : (n,)
        As the log has them, in seconds; neither sorted nor evenly spaced.
    received
        Whether the stamps are of receipt by the recorder, not of measurement.
    episode : (n,)
        Which part of a log that was cut already a sample belongs to; None if it was not.
    findings
        What was done to read it, and what is in doubt.
    receipt_s : (n,)
        When the recorder received each sample, on the recorder's clock; None where the log does not say.
    publisher : (n,)
        Which of several writers of one topic sent a sample, from 0; None where one did.
    lerobot
        Whether it is a LeRobot data set, whose joints may be degrees or shares of their range.
    """

    name: str
    time_s: FloatArray
    columns: tuple[Column, ...]
    received: bool = False
    episode: NDArray[np.int64] | None = None
    findings: tuple[Finding, ...] = ()
    receipt_s: FloatArray | None = None
    publisher: NDArray[np.int64] | None = None
    lerobot: bool = False

    def at(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> "Stream":
        """Return the same with these rows alone."""
        return replace(
            self,
            time_s=self.time_s[rows],
            columns=tuple(replace(column, values=column.values[rows]) for column in self.columns),
            episode=None if self.episode is None else self.episode[rows],
            receipt_s=None if self.receipt_s is None else self.receipt_s[rows],
            publisher=None if self.publisher is None else self.publisher[rows],
        )


def column(
    group: str,
    label: str,
    values: FloatArray,
    *,
    unit: str = "",
    position: int | None = None,
    width: int | None = None,
) -> Column:
    """Return a column, with what its name says: `group` is its topic or table, `label` its own name in it."""
    bare, bracketed = bracketed_unit(label)
    unit = unit or bracketed
    words = [word for word in _SPLIT.split(bare if unit else label) if word]
    words = [part for word in words for part in _apart(word)]
    around = {word.lower() for word in _SPLIT.split(group) if word}
    own = {word.lower() for word in words}
    role = _role(own) if own & _ANY_ROLE else _role(around)
    if role in ("position", "unknown") and _role(around) == "command":
        role = "command"  # action/shoulder.pos is a goal
    stated = unit or next(
        (_NAME_UNITS[word] for word in (*map(str.lower, words), *around) if word in _NAME_UNITS), ""
    )
    if stated in ("A", "mA") and role in ("unknown", "torque", "position"):
        role = "current"
    stem = "_".join(
        word for word in words if word.lower() not in _ANY_ROLE and word.lower() not in _NAME_UNITS
    )
    if not stem and position is None:  # a group for each joint: shoulder/position
        last = group.rpartition("/")[2]
        stem = "_".join(word for word in _SPLIT.split(last) if word and word.lower() not in _ANY_ROLE)
    by_order = bool({"qpos", "ctrl"} & (own | around))
    name = f"{group}/{label}" if label and group else group or label
    if position is not None and not label:
        name, stem = f"{group}[{position}]", ""
    return Column(name, stem, role, np.asarray(values, dtype=np.float64), stated, position, width, by_order)


def bracketed_unit(label: str) -> tuple[str, str]:
    """Return a label without the unit in brackets behind it, and the unit: "" where it has none that is known."""
    bracket = _BRACKETED.match(label)
    unit = UNIT_WORDS.get(bracket[2].lower(), "") if bracket else ""
    return (bracket[1] if bracket and unit else label), unit


def vector(group: str, values: FloatArray, names: tuple[str, ...] | None = None) -> list[Column]:
    """Return the columns of a table of shape (n, k), which may have names."""
    width = values.shape[1]
    labels = names if names is not None and len(names) == width else ("",) * width
    return [
        column(group, label, values[:, index], position=index, width=width)
        for index, label in enumerate(labels)
    ]


def plain(name: str) -> str:
    """Return a name without case and punctuation, for comparison."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def separate_sparse(stream: Stream) -> list[Stream]:
    """Return a stream for every set of columns that are present in the same rows, each with its own stamps.

    Joints that are polled in turn, and tables that hold several topics, leave most cells of a row blank.
    """
    present = [np.isfinite(column.values) for column in stream.columns]
    groups: list[tuple[NDArray[np.bool_], list[Column]]] = []
    blank = []
    for column_, rows in zip(stream.columns, present, strict=True):
        if not rows.any():
            blank.append(column_.name)
            continue
        for index, (other, columns) in enumerate(groups):
            if np.count_nonzero(rows & other) >= SAME_ROWS * max(rows.sum(), other.sum()):
                columns.append(column_)
                groups[index] = rows | other, columns
                break
        else:
            groups.append((rows, [column_]))
    findings = list(stream.findings)
    if blank:
        findings.append(Statement(f"{stream.name}: no number in {', '.join(blank[:8])}; left out"))
    if len(groups) == 1:
        return [replace(stream, columns=tuple(groups[0][1]), findings=tuple(findings))]
    if groups:
        counts = ", ".join(f"{columns[0].name} {int(rows.sum())}" for rows, columns in groups[:6])
        findings.append(
            Statement(
                f"{stream.name}: columns of {len(groups)} rates, each with its own stamps ({counts} samples)"
            )
        )
    separated = []
    for index, (rows, columns) in enumerate(groups):
        name = stream.name if not index else f"{stream.name} ({columns[0].name})"
        part = replace(stream, name=name, columns=tuple(columns), findings=() if index else tuple(findings))
        separated.append(part.at(rows))
    return separated


def is_episode(name: str) -> bool:
    """Tell whether a column's name says that it tells episodes apart."""
    return name.lower() in _EPISODE_COLUMNS


def episode_runs(labels: NDArray[np.int64] | FloatArray) -> NDArray[np.int64]:
    """Return a number for every run of equal labels, from 0: an episode that comes again is another one."""
    changed = np.append(False, labels[1:] != labels[:-1])
    return np.cumsum(changed).astype(np.int64)


def _apart(word: str) -> Sequence[str]:
    """Return a word of a role and the number behind it apart: ``meas1`` is ``meas`` and ``1``."""
    numbered = _NUMBERED_WORD.fullmatch(word)
    apart = numbered is not None and len(numbered[1]) > 2 and numbered[1].lower() in _ANY_ROLE
    return numbered.groups() if numbered is not None and apart else (word,)


def _role(words: set[str] | frozenset[str]) -> Role:
    has = {role for role, known in _WORDS.items() if words & known}
    commanded = "command" in has
    if "acceleration" in has:
        return "unknown"
    if "current" in has:
        # "current_position" is where a joint is now
        return "position" if "position" in has else "velocity" if "velocity" in has else "current"
    if "torque" in has:
        return "torque-command" if commanded else "torque"
    if "velocity" in has:
        return "velocity-command" if commanded else "velocity"
    return "command" if commanded else "position" if has & {"position", "present"} else "unknown"
