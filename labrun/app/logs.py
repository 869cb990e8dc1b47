"""A log of a robot and its description, made into a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from labrun.app.question import named_model
from labrun.errors import RecordingError, RequestError
from labrun.logs import (
    LEAST_SAMPLES,
    LEAST_TRIAL_S,
    TICKS,
    LogTable,
    Piece,
    Stream,
    Unit,
    Wanted,
    cut,
    in_si,
    matched,
    plain,
    read_log,
    table_of,
    unusable,
    write_recording,
)
from labrun.models import Model, Robot, is_robot, load_model, read_robot, robot_table

_STILL = 0.05
"""A trial begins at rest if nothing is faster there than this share of its greatest speed."""


@dataclass(frozen=True, slots=True)
class ImportedLog:
    """A recording that was made from a log.

    Attributes
    ----------
    folder
    channels : (name in the model, column of the log)
    trials, duration_s
        How many, and how long together.
    remarks
        What was found and done, sentences.
    """

    folder: Path
    channels: tuple[tuple[str, str], ...]
    trials: int
    duration_s: float
    remarks: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "recording": str(self.folder), "channels": dict(self.channels), "trials": self.trials,
            "duration_s": self.duration_s, "remarks": list(self.remarks),
        }  # fmt: skip

    def to_text(self) -> str:
        """Return what a person wants to know of it."""
        width = max(len(name) for name, _ in self.channels)
        lines = [f"{self.trials} trial{'s' * (self.trials != 1)}, {self.duration_s:.4g} s"]
        lines += [f"  {name:<{width}}  {column}" for name, column in self.channels]
        return "\n".join([*lines, *self.remarks, f"wrote {self.folder}"])


def import_log(
    log: str | Path,
    model: str | Path,
    to: str | Path | None = None,
    *,
    mapping: Sequence[str] = (),
    unit: str | None = None,
    cut_s: float | None = None,
    rate_hz: float | None = None,
) -> ImportedLog:
    """Make a recording of a robot's log: its columns matched by name, its stamps repaired, cut into trials.

    Parameters
    ----------
    log
        What `labrun.logs.read_log` reads.
    model
        An MJCF or URDF file, or a model.
    to
        The folder to write; ``recordings/<log>`` if None.
    mapping
        ``CHANNEL=COLUMN``: which column of the log a channel, joint or actuator is; ``none`` for none.
    unit
        Of the log's angles: ``rad``, ``deg``, ``ticks`` (of 4096 a turn, or ``ticks:16384``), ``normalised``; told
        from their range if None.
    cut_s
        Length of the trials; at rests if None.
    rate_hz
        Of samples without stamps.

    Raises
    ------
    RequestError
        Something is unclear, and only a person can say it; nothing was written.
    RecordingError
        The log cannot be read or repaired.
    """
    log, model = Path(log).expanduser(), Path(model).expanduser()
    folder = _free(Path("recordings") / log.stem) if to is None else Path(to)
    unit, ticks = _unit(unit)
    if cut_s is not None and not cut_s > 0:
        raise RequestError(f"trials cannot be {cut_s:g} s long")
    asked = _asked(mapping)
    streams = read_log(log, rate_hz)
    robot = _driven(model, streams, asked) if is_robot(model) else None
    loaded = None if robot else named_model(model, Path())
    found, said = matched(_of_robot(robot) if robot else _of_model(loaded), streams, asked)
    matches, units = in_si(found, unit, ticks)  # type: ignore[arg-type]
    table, repairs = table_of(matches)
    bad = list(unusable(table))
    trials, how = cut(table, cut_s, [piece for piece, _ in bad])
    if not trials:
        short = f"no trial would be {LEAST_TRIAL_S:g} s and {LEAST_SAMPLES} samples long"
        raise RecordingError(
            f"nothing of {log} can be used: {'; '.join(dict.fromkeys([*(why for _, why in bad), short]))}",
            hint="cut longer trials: --cut 10s" if cut_s is not None else None,
        )
    remarks = [
        *(robot.remarks if robot else ()),
        *said,
        *(_unused(robot, streams, [one.column.name for one in matches if one.column]) if robot else ()),
        *units,
        *repairs,
        *_left_out(table, bad),
        f"cut {how}",
    ]
    if robot is not None:
        measured = [
            one.wanted.channel for one in matches if one.wanted.kind == "output" and one.column is not None
        ]
        start = "rest" if _at_rest(table, trials) else "free"
        text = robot_table(robot, xml_file="robot.xml", start=start, measured=measured)  # type: ignore[arg-type]
        files = {"robot.xml": robot.xml, "model.toml": f"# from {model.name}\n{text}"}
    else:
        source = model.resolve() if model.is_file() else model
        files = {"model.toml": f'base = "{source}"\n'}
    write_recording(folder, folder.resolve().name, table, trials, remarks, files)
    if robot is not None:
        load_model(folder / "model.toml")
    length = sum(float(table.time_s[piece.end - 1] - table.time_s[piece.first]) for piece in trials)
    shown = tuple((one.wanted.channel, one.column.name if one.column else "none") for one in matches)
    return ImportedLog(folder, shown, len(trials), length, tuple(remarks))


def _unit(text: str | None) -> tuple[str | None, int]:
    """Return the unit, and how many ticks a turn has."""
    unit, colon, ticks = (text or "").partition(":")
    if text is None or (not colon and unit in get_args(Unit)):
        return text, TICKS
    if unit == "ticks" and ticks.isdigit() and int(ticks) > 1:
        return unit, int(ticks)
    raise RequestError(
        f"{text!r} is no unit of angles", hint=f"one of {', '.join(get_args(Unit))}, or ticks:16384"
    )


def _asked(mapping: Sequence[str]) -> dict[str, str]:
    asked = {}
    for text in mapping:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals and value.strip()):
            raise RequestError(f"--map {text} says no channel and column", hint="--map shoulder=joint_1")
        asked[name.strip()] = value.strip()
    return asked


def _driven(path: Path, streams: Sequence[Stream], asked: Mapping[str, str]) -> Robot:
    """Return the robot, with an actuator at each joint that has none and whose command the log holds."""
    robot = read_robot(path)
    moved = {one.joint for one in robot.actuators}
    columns = [column for stream in streams for column in stream.columns]
    drives: dict[str, Any] = {}
    for joint in robot.joints:
        names = {plain(joint.name), plain(asked.get(joint.name, joint.name))}
        roles = {column.role for column in columns if plain(column.stem) in names}
        told = {plain(name) for name in asked}
        if joint.name in moved:
            continue
        if "command" in roles or plain(f"{joint.output}_command") in told:
            drives[joint.name] = "position"
        elif roles & {"torque", "torque-command"} or plain(f"{joint.output}_torque") in told:
            drives[joint.name] = "torque"
    return read_robot(path, drives) if drives else robot


def _unused(robot: Robot, streams: Sequence[Stream], used: Sequence[str]) -> list[str]:
    """Return what the log tells that nothing of the robot takes, where joints without an actuator are."""
    moved = {one.joint for one in robot.actuators}
    free = [one.output for one in robot.joints if one.name not in moved]
    if not free:
        return []
    roles = ("command", "torque-command", "velocity-command")
    columns = [one for stream in streams for one in stream.columns if one.name not in used]
    left = [one.name for one in columns if one.role in roles]
    said = (
        [
            f"{', '.join(left)} is not used: the file has no actuator at {', '.join(free)}; "
            f"--map {free[0]}_command={left[0]} makes it the goal of a servo of unknown gains there"
        ]
        if left
        else []
    )
    unknown = [one.name for one in columns if one.role == "unknown"]
    for joint in free:
        near = next((one for one in unknown if plain(joint) in plain(one)), None)
        if near is not None:
            said.append(
                f"{near} is not used: it names neither goal nor torque; --map {joint}_torque={near} makes it the "
                f"torque at {joint}, where the file has no actuator"
            )
    return said


def _of_robot(robot: Robot) -> list[Wanted]:
    roles: dict[str, tuple[Any, ...]] = {
        "position": ("command",), "velocity": ("velocity-command", "command"),
        "torque": ("torque-command", "torque", "command"),
        **dict.fromkeys(("geared", "other"), ("command", "torque-command", "torque")),
    }  # fmt: skip
    outputs = [
        Wanted(
            one.output, one.unit, "output", (one.name, one.output), ("position", "unknown"), place,
            len(robot.joints), one.range,
        )
        for place, one in enumerate(robot.joints)
    ]  # fmt: skip
    ranges = {one.name: one.range for one in robot.joints}
    inputs = [
        Wanted(
            one.input, one.unit, "input", tuple(dict.fromkeys((one.joint or one.name, one.name))),
            roles[one.command], place, len(robot.actuators), ranges.get(one.joint),
        )
        for place, one in enumerate(robot.actuators)
    ]  # fmt: skip
    return [*inputs, *outputs]


def _of_model(model: Model | None) -> list[Wanted]:
    if model is None:
        return []
    commands: tuple[Any, ...] = (
        "command",
        "torque-command",
        "velocity-command",
        "unknown",
        "torque",
        "position",
    )
    inputs = [Wanted(one.name, one.unit, "input", (one.name,), commands) for one in model.inputs]
    measured: tuple[Any, ...] = ("position", "unknown", "velocity", "torque")
    return [*inputs, *(Wanted(one.name, one.unit, "output", (one.name,), measured) for one in model.outputs)]


def _left_out(table: LogTable, bad: Sequence[tuple[Piece, str]]) -> list[str]:
    times: dict[str, list[str]] = {}
    for piece, why in bad:
        span = f"{table.time_s[piece.first]:.3f} to {table.time_s[piece.end - 1]:.3f} s"
        times.setdefault(why, []).append(span)
    return [f"left out {', '.join(spans)}: {why}" for why, spans in times.items()]


def _at_rest(table: LogTable, trials: Sequence[Piece]) -> bool:
    """Tell whether every trial begins at rest, as far as its first tenth of a second shows it through the noise."""
    period = float(np.median(np.diff(table.time_s)))
    count = max(5, round(0.1 / period))
    for place, match in enumerate(table.matches):
        if match.wanted.kind == "input" or match.column is None:
            continue
        course = table.values[:, place]
        fastest = float(np.quantile(np.abs(np.gradient(course, table.time_s)), 0.99))
        noise = float(np.median(np.abs(np.diff(course))))
        doubt = noise / period * np.sqrt(12 / count**3)  # standard error of a slope through so many samples
        for piece in trials:
            few = slice(piece.first, min(piece.first + count, piece.end))
            slope = abs(float(np.polyfit(table.time_s[few] - table.time_s[piece.first], course[few], 1)[0]))
            if slope > _STILL * fastest + 4 * doubt:
                return False
    return True


def _free(folder: Path) -> Path:
    number = 2
    found = folder
    while found.exists():
        found = folder.with_name(f"{folder.name}-{number}")
        number += 1
    return found
