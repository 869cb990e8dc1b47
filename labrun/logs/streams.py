"""What every reader returns: streams of named columns over time, and what the name of a column says of it."""

import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray

Role = Literal["position", "velocity", "torque", "command", "velocity-command", "torque-command", "unknown"]
_WORDS: dict[str, frozenset[str]] = {
    "command": frozenset((
        "cmd", "cmds", "command", "commands", "commanded", "goal", "goals", "target", "targets", "ref", "reference",
        "references", "desired", "des", "setpoint", "setpoints", "sp", "action", "actions", "ctrl", "control",
    )),
    "velocity": frozenset(("vel", "velocity", "velocities", "qvel", "dq", "speed", "rate")),
    "torque": frozenset(("torque", "torques", "effort", "efforts", "tau")),
    "position": frozenset((
        "pos", "position", "positions", "qpos", "q", "angle", "angles", "state", "states", "actual", "measured", "meas",
        "feedback", "present", "encoder", "enc",
    )),
    "acceleration": frozenset(("acc", "acceleration", "accelerations", "qacc", "ddq")),
}  # fmt: skip
_UNITS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "radian": "rad", "radians": "rad", "ticks": "ticks",
    "counts": "ticks", "normalized": "normalised", "normalised": "normalised",
}  # fmt: skip
_SPLIT = re.compile(r"[^A-Za-z0-9]+|(?<=[a-z])(?=[A-Z])")


@dataclass(frozen=True)
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
    unit
        That its format or name states; "" for none.
    place, width
        Which part of a vector of how many it is; None where it stands alone.
    by_order
        Whether the vector's order is the robot's own, as MuJoCo's ``qpos`` and ``ctrl``.
    """

    name: str
    stem: str
    role: Role
    values: FloatArray
    unit: str = ""
    place: int | None = None
    width: int | None = None
    by_order: bool = False


@dataclass(frozen=True)
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
    remarks
        What was done to read it.
    before_receipt_s
        How far its stamps lie before their receipt, by the median; 0 for stamps of receipt, None where there is none.
    """

    name: str
    time_s: FloatArray
    columns: tuple[Column, ...]
    received: bool = False
    episode: NDArray[np.int64] | None = None
    remarks: tuple[str, ...] = field(default=())
    before_receipt_s: float | None = None


def column(
    group: str,
    label: str,
    values: FloatArray,
    *,
    unit: str = "",
    place: int | None = None,
    width: int | None = None,
) -> Column:
    """Return a column, with what its name says: `group` is its topic or table, `label` its own name in it."""
    words = [word for word in _SPLIT.split(label) if word]
    around = [word for word in _SPLIT.split(group) if word]
    own = {word.lower() for word in words}
    role = _role(own) if own & _any_role() else _role({word.lower() for word in around})
    if role in ("position", "unknown") and _role({word.lower() for word in around}) == "command":
        role = "command"  # action/shoulder.pos is a goal
    stated = unit or next((_UNITS[word.lower()] for word in (*words, *around) if word.lower() in _UNITS), "")
    stem = "_".join(word for word in words if word.lower() not in _any_role() and word.lower() not in _UNITS)
    by_order = bool({"qpos", "ctrl"} & {*own, *(word.lower() for word in around)})
    name = f"{group}/{label}" if label and group else group or label
    if place is not None and not label:
        name, stem = f"{group}[{place}]", ""
    return Column(name, stem, role, np.asarray(values, dtype=np.float64), stated, place, width, by_order)


def vector(group: str, values: FloatArray, names: tuple[str, ...] | None = None) -> list[Column]:
    """Return the columns of a table of shape (n, k), which may have names."""
    width = values.shape[1]
    labels = names if names is not None and len(names) == width else ("",) * width
    return [
        column(group, label, values[:, place], place=place, width=width) for place, label in enumerate(labels)
    ]


def plain(name: str) -> str:
    """Return a name without case and punctuation, for comparison."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _any_role() -> frozenset[str]:
    return frozenset().union(*_WORDS.values())


def _role(words: set[str]) -> Role:
    has = {role for role, known in _WORDS.items() if words & known}
    if "acceleration" in has:
        return "unknown"
    if "torque" in has:
        return "torque-command" if "command" in has else "torque"
    if "velocity" in has:
        return "velocity-command" if "command" in has else "velocity"
    return "command" if "command" in has else "position" if "position" in has else "unknown"
