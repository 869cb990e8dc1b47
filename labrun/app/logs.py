"""Import a robot's log with its description as a recording, or preview the import."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from labrun.app.question import named_model
from labrun.errors import LabrunError, RecordingError, RequestError
from labrun.logs import (
    HEADER,
    LEAST_SAMPLES,
    LEAST_TRIAL_S,
    NOT,
    SCALES,
    AskedUnits,
    ChannelPreview,
    Finding,
    LogTable,
    Match,
    Piece,
    Question,
    ReadOptions,
    StampSource,
    Statement,
    Stream,
    Wanted,
    align_clocks,
    check_ranges,
    correct_turns,
    cut,
    decide_units,
    in_no_trial,
    joined,
    matched,
    motions,
    numbered,
    plain,
    previews,
    questions,
    read_log,
    require_answered,
    require_free,
    statements,
    table_of,
    unusable,
    unused,
    write_recording,
)
from labrun.models import Model, Robot, is_robot, load_model, read_robot, robot_table
from labrun.report import aligned

_STILL = 0.05
"""A trial begins at rest if nothing is faster there than this share of its greatest speed."""


_TORQUE_ROLES = frozenset({"torque", "torque-command", "current"})
"""Roles of columns that tell the torque of a joint of which the file has no actuator."""


@dataclass(frozen=True, slots=True)
class LogAnswers:
    """Answers to questions about a log; each is the text of its flag.

    Attributes
    ----------
    mapping
        ``CHANNEL=COLUMN``: which column of the log a channel, joint or actuator is; ``none`` for none.
    units
        ``UNIT`` for all angles, or ``JOINT=UNIT``: ``rad``, ``deg``, ``ticks`` (of 4096 a turn, or ``ticks:16384``),
        ``normalised``, ``percent``, ``m``, ``mm``; ``CHANNEL=A:0.9`` of a torque, N m per ampere.
    zeros
        ``JOINT=NUMBER``: what the log reads where the model has zero.
    publishers
        ``TOPIC=NUMBER``: which of several writers of a topic counts.
    times
        ``COLUMN`` or ``ARRAY=COLUMN``: which column holds the time.
    time_unit
        Of columns of time: ``s``, ``ms``, ``us`` or ``ns``.
    stamps
        ``own`` or ``receipt``: which stamps of messages count.
    rate_hz
        Of samples without stamps.
    cut_s
        Length of the trials; episodes, or pieces between rests, if None.
    repair
        Whether inertias that no body can have are replaced by the nearest possible ones.
    """

    mapping: Sequence[str] = ()
    units: Sequence[str] = ()
    zeros: Sequence[str] = ()
    publishers: Sequence[str] = ()
    times: Sequence[str] = ()
    time_unit: str | None = None
    stamps: str | None = None
    rate_hz: float | None = None
    cut_s: float | None = None
    repair: bool = False


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
        """Return the text that the terminal prints."""
        width = max(len(name) for name, _ in self.channels)
        lines = [f"{self.trials} trial{'s' * (self.trials != 1)}, {self.duration_s:.4g} s"]
        lines += [f"  {name:<{width}}  {column}" for name, column in self.channels]
        return "\n".join([*lines, *self.remarks, f"wrote {self.folder}"])


@dataclass(frozen=True, slots=True)
class LogPreview:
    """What an import would read, and its open questions; nothing is written.

    Attributes
    ----------
    channels
        A row for each channel and log.
    trials, duration_s
        How many there would be, and how long together.
    remarks
        What was found and would be done.
    questions
        What has to be answered first.
    """

    channels: tuple[ChannelPreview, ...]
    trials: int
    duration_s: float
    remarks: tuple[str, ...]
    questions: tuple[Question, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {
            "channels": [channel.to_json() for channel in self.channels], "trials": self.trials,
            "duration_s": self.duration_s, "remarks": list(self.remarks),
            "questions": [question.to_json() for question in self.questions],
        }  # fmt: skip

    def to_text(self) -> str:
        """Return the table, the statements and the questions."""
        lines = aligned([list(HEADER), *(channel.cells() for channel in self.channels)])
        lines.append(f"{self.trials} trial{'s' * (self.trials != 1)}, {self.duration_s:.4g} s")
        lines += self.remarks
        lines += [f"question: {question.to_text()}" for question in self.questions]
        end = "answer the questions, or copy their proposals" if self.questions else "no question is open"
        return "\n".join([*lines, f"nothing was written; {end}"])


@dataclass(frozen=True, slots=True)
class _Reading:
    """Everything read from the logs, with proposals for missing answers.

    Attributes
    ----------
    logs
        The matches of each log.
    table
        None where nothing can be put together before a question is answered.
    """

    robot: Robot | None
    logs: list[list[Match]]
    columns: tuple[str, ...]
    table: LogTable | None
    trials: list[Piece]
    motions: list[str]
    findings: list[Finding]

    def duration_s(self) -> float:
        if self.table is None:
            return 0.0
        time_s = self.table.time_s
        return sum(float(time_s[piece.end - 1] - time_s[piece.first]) for piece in self.trials)


def import_log(
    log: str | Path | Sequence[str | Path],
    model: str | Path,
    to: str | Path | None = None,
    *,
    answers: LogAnswers | None = None,
    mapping: Sequence[str] = (),
    unit: str | Sequence[str] | None = None,
    cut_s: float | None = None,
    rate_hz: float | None = None,
) -> ImportedLog:
    """Import robot logs: match columns by name, repair stamps and turns, cut into trials.

    Parameters
    ----------
    log
        What `labrun.logs.read_log` reads; several logs of one robot become one recording, the log in its conditions.
    model
        An MJCF or URDF file, or a model.
    to
        The folder to write; ``recordings/<log>`` if None.
    answers
        What a person said; the parameters after it stand for its fields of these names.

    Raises
    ------
    RequestError
        Something is unclear, and only a person can say it; nothing was written.
    RecordingError
        The log cannot be read or repaired.
    """
    paths, model = _paths(log), Path(model).expanduser()
    folder = _free(Path("recordings") / paths[0].stem) if to is None else Path(to)
    require_free(folder)
    reading = _read(paths, model, _answers(answers, mapping, unit, cut_s, rate_hz))
    require_answered(reading.findings, reading.columns)
    if reading.table is None:
        raise RecordingError(f"nothing of {', '.join(map(str, paths))} can be used")
    remarks = statements(reading.findings)
    write_recording(
        folder, folder.resolve().name, reading.table, reading.trials, reading.motions, _names(paths), remarks,
        _model_files(reading, model),
    )  # fmt: skip
    if reading.robot is not None:
        load_model(folder / "model.toml")
    columns: dict[str, list[str]] = {}
    for match in (match for matches in reading.logs for match in matches):
        columns.setdefault(match.wanted.channel, []).append(match.column.name if match.column else "none")
    shown = tuple((channel, ", ".join(dict.fromkeys(names))) for channel, names in columns.items())
    return ImportedLog(folder, shown, len(reading.trials), reading.duration_s(), tuple(remarks))


def preview_log(
    log: str | Path | Sequence[str | Path], model: str | Path, *, answers: LogAnswers | None = None
) -> LogPreview:
    """Return what `import_log` would read of a log, with its statements and open questions; write nothing.

    Raises
    ------
    RequestError, RecordingError
        The log or the model cannot be read at all.
    """
    paths, model = _paths(log), Path(model).expanduser()
    reading = _read(paths, model, answers or LogAnswers())
    used = [0] * len(paths)
    for piece in reading.trials if reading.table is not None else ():
        used[int(reading.table.log[piece.first])] += piece.end - piece.first  # type: ignore[union-attr]
    rows = tuple(previews(reading.logs, _names(paths), used))
    remarks = tuple(statements(reading.findings))
    return LogPreview(
        rows, len(reading.trials), reading.duration_s(), remarks, tuple(questions(reading.findings))
    )


def _paths(log: str | Path | Sequence[str | Path]) -> list[Path]:
    given = [log] if isinstance(log, str | Path) else list(log)
    if not given:
        raise RequestError("no log was given", hint="--log run.mcap")
    return [Path(path).expanduser() for path in given]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return distinct names of logs, numbered if equal."""
    names = [path.name for path in paths]
    return [
        f"{name} ({names[: index + 1].count(name)})" if names.count(name) > 1 else name
        for index, name in enumerate(names)
    ]


def _answers(
    answers: LogAnswers | None,
    mapping: Sequence[str],
    unit: str | Sequence[str] | None,
    cut_s: float | None,
    rate_hz: float | None,
) -> LogAnswers:
    given = answers or LogAnswers()
    units = () if unit is None else [unit] if isinstance(unit, str) else unit
    return replace(
        given,
        mapping=[*given.mapping, *mapping],
        units=[*given.units, *units],
        cut_s=given.cut_s if cut_s is None else cut_s,
        rate_hz=given.rate_hz if rate_hz is None else rate_hz,
    )


def _read(paths: Sequence[Path], model: Path, answers: LogAnswers) -> _Reading:
    """Read all logs and take every step that leads to trials; a question's proposal stands in for its answer."""
    if answers.cut_s is not None and not answers.cut_s > 0:
        raise RequestError(
            f"invalid length of trials {answers.cut_s:g} s for --cut; write for example --cut 10s"
        )
    asked, units = _asked(answers.mapping), AskedUnits.parsed(answers.units, answers.zeros)
    options = ReadOptions(answers.rate_hz, _time_unit(answers.time_unit), _times(answers.times))
    publishers = _publishers(answers.publishers)
    logs = [read_log(path, options, publishers) for path in paths]
    streams = [stream for log in logs for stream in log]
    findings: list[Finding] = [finding for stream in streams for finding in stream.findings]
    robot = _driven(model, streams, asked, repair=answers.repair) if is_robot(model) else None
    wanted = _of_robot(robot) if robot else _of_model(named_model(model, Path()))
    findings = [*map(Statement, robot.remarks if robot else ()), *findings]
    answered = _without_absent_drives(asked, wanted, robot)
    matches: list[list[Match]] = []
    for log in logs:
        pairs, doubts = matched(wanted, log, _within(answered, log, streams))
        matches.append(pairs)
        findings += [*doubts, *unused(pairs, log)]
    if robot:
        findings += _undriven(robot, streams, matches, asked)
    torques_alone = robot is not None and robot.is_told_torques
    matches, doubts = decide_units(matches, units, currents_stay=torques_alone)
    findings += doubts
    for index, pairs in enumerate(matches):
        pairs, clocks = align_clocks(pairs, _stamps(answers.stamps))  # noqa: PLW2901
        matches[index], turns = correct_turns(pairs)
        findings += [*clocks, *turns]
    findings += check_ranges(matches)
    columns = tuple(sorted({column.name for stream in streams for column in stream.columns}))
    try:
        tables = []
        for pairs in matches:
            table, repairs = table_of(pairs)
            tables.append(table)
            findings += repairs
        whole = joined(tables)
        bad = list(unusable(whole))
        trials, how = cut(whole, answers.cut_s, [piece for piece, _ in bad])
        if not trials:
            short = f"no trial would be {LEAST_TRIAL_S:g} s and {LEAST_SAMPLES} samples long"
            raise RecordingError(
                f"nothing of {', '.join(map(str, paths))} can be used: "
                f"{'; '.join(dict.fromkeys([*(why for _, why in bad), short]))}",
                hint="cut longer trials: --cut 10s" if answers.cut_s is not None else None,
            )
    except LabrunError:
        if not questions(findings):
            raise
        return _Reading(robot, matches, columns, None, [], [], findings)
    lost = in_no_trial(whole, trials, [piece for piece, _ in bad])
    names, trials, trimmed = motions(whole, trials)
    findings += [*map(Statement, _left_out(whole, bad)), Statement(how), *lost, *trimmed]
    return _Reading(robot, matches, columns, whole, trials, names, findings)


def _without_absent_drives(
    asked: Mapping[str, str], wanted: Sequence[Wanted], robot: Robot | None
) -> dict[str, str]:
    """Return the answers without those that a joint gets no drive: it has no such channel then."""
    channels = {plain(channel.channel) for channel in wanted}
    joints = () if robot is None else robot.joints
    drives = {
        plain(f"{joint.output}_{kind}") for joint in joints for kind in ("command", "torque")
    } - channels
    return {name: value for name, value in asked.items() if value != NOT or plain(name) not in drives}


def _within(asked: Mapping[str, str], log: Sequence[Stream], streams: Sequence[Stream]) -> dict[str, str]:
    """Return the answers that concern one log."""

    def names(some: Sequence[Stream]) -> set[str]:
        return {
            plain(name) for stream in some for column in stream.columns for name in (column.name, column.stem)
        }

    own, every = names(log), names(streams)
    return {key: value for key, value in asked.items() if plain(value) in own or plain(value) not in every}


def _time_unit(text: str | None) -> str | None:
    if text is not None and text not in SCALES:
        raise RequestError(f"--time-unit {text}: one of {', '.join(SCALES)} was expected")
    return text


def _stamps(text: str | None) -> StampSource | None:
    if text in (None, *get_args(StampSource)):
        return cast("StampSource | None", text)
    raise RequestError(f"--stamps {text}: own or receipt was expected")


def _times(given: Sequence[str]) -> dict[str, str]:
    times = {}
    for text in given:
        array, _, column = text.rpartition("=")
        times[array.strip()] = column.strip()
    return times


def _publishers(given: Sequence[str]) -> dict[str, int]:
    chosen = {}
    for text in given:
        topic, equals, number = text.rpartition("=")
        if not (equals and topic.strip() and number.strip().isdigit()):
            raise RequestError(
                f"--publisher {text}: a topic and a number were expected", hint="--publisher /joint_states=2"
            )
        chosen[topic.strip()] = int(number)
    return chosen


def _model_files(reading: _Reading, model: Path) -> dict[str, str]:
    """Return the model's files that stand beside the trials."""
    robot, table = reading.robot, reading.table
    if robot is None or table is None:
        source = model.resolve() if model.is_file() else model
        return {"model.toml": f'base = "{source}"\n'}
    measured = [table.wanted[index].channel for index in table.recorded("output")]
    start = "rest" if _at_rest(table, reading.trials) else "free"
    units = {wanted.channel: wanted.unit for wanted in table.wanted}
    drives = [replace(drive, unit=units.get(drive.input, drive.unit)) for drive in robot.actuators]
    logged = replace(robot, actuators=tuple(drives))
    text = robot_table(logged, xml_file="robot.xml", start=start, measured=measured)  # type: ignore[arg-type]
    return {"robot.xml": robot.xml, "model.toml": f"# from {model.name}\n{text}"}


def _asked(mapping: Sequence[str]) -> dict[str, str]:
    asked = {}
    for text in mapping:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals and value.strip()):
            raise RequestError(f"--map {text} says no channel and column", hint="--map shoulder=joint_1")
        asked[name.strip()] = value.strip()
    return asked


def _driven(path: Path, streams: Sequence[Stream], asked: Mapping[str, str], *, repair: bool) -> Robot:
    """Return the robot with an actuator added at each joint whose command is in the log."""
    robot = read_robot(path, repair=repair)
    moved = {actuator.joint for actuator in robot.actuators}
    columns = [column for stream in streams for column in stream.columns]
    answered = {plain(name): value for name, value in asked.items()}
    drives: dict[str, Any] = {}
    for joint in robot.joints:
        if joint.name in moved:
            continue
        names = {plain(joint.name), plain(asked.get(joint.name, joint.name))}
        roles = {column.role for column in columns if plain(column.stem) in names}
        command, torque = (answered.get(plain(f"{joint.output}_{kind}")) for kind in ("command", "torque"))
        if torque not in (None, NOT):
            drives[joint.name] = "torque"
        elif command not in (None, NOT) or ("command" in roles and command != NOT):
            drives[joint.name] = "position"
        elif roles & _TORQUE_ROLES and torque != NOT:
            drives[joint.name] = "torque"
    return read_robot(path, drives, repair=repair) if drives else robot


def _undriven(
    robot: Robot, streams: Sequence[Stream], logs: Sequence[Sequence[Match]], asked: Mapping[str, str]
) -> list[Finding]:
    """Return what is asked and said of what the log tells where joints without an actuator are."""
    moved = {actuator.joint for actuator in robot.actuators}
    free = [joint.output for joint in robot.joints if joint.name not in moved]
    if not free:
        return []
    used = {match.column.name for log in logs for match in log if match.column is not None}
    pairs = [(stream, column) for stream in streams for column in stream.columns if column.name not in used]
    findings: list[Finding] = []
    answered = {plain(name) for name in asked}
    kinds: tuple[tuple[str, str, tuple[str, ...]], ...] = (
        ("torque", "torque", tuple(_TORQUE_ROLES)), ("goal of a servo", "command", ("command",)),
    )  # fmt: skip
    for kind, suffix, roles in kinds:
        own = [(stream, column) for stream, column in pairs if column.role in roles]
        for index, joint in enumerate(robot.joints):
            pair = numbered(index, len(robot.joints), own)
            if joint.output not in free or pair is None or plain(f"{joint.output}_{suffix}") in answered:
                continue
            flag = f"--map {joint.output}_{suffix}"
            text = (
                f"the file has no actuator at {joint.output}; by its number {pair[1].name} may be the {kind}"
            )
            findings.append(Question(text, f"{flag}={pair[1].name}", f"{flag}={NOT}", joint.output))
        if findings:
            return findings
    commands = [
        column.name for _, column in pairs if column.role in ("command", "torque-command", "velocity-command")
    ]
    if commands:
        text = (
            f"{', '.join(commands)} is not used: the file has no actuator at {', '.join(free)}; "
            f"--map {free[0]}_command={commands[0]} makes it the goal of a servo of unknown gains there"
        )
        findings.append(Statement(text))
    unknown = [column.name for _, column in pairs if column.role in ("unknown", *_TORQUE_ROLES)]
    for output in free:
        near = next((name for name in unknown if plain(output) in plain(name)), None)
        if near is not None:
            text = (
                f"{near} is not used: it names neither goal nor torque; --map {output}_torque={near} makes it the "
                f"torque at {output}, where the file has no actuator"
            )
            findings.append(Statement(text, output))
    return findings


def _of_robot(robot: Robot) -> list[Wanted]:
    roles: dict[str, tuple[Any, ...]] = {
        "position": ("command",), "velocity": ("velocity-command", "command"),
        "torque": ("torque-command", "torque", "current", "command"),
        **dict.fromkeys(("geared", "other"), ("command", "torque-command", "torque", "current")),
    }  # fmt: skip
    outputs = [
        Wanted(
            joint.output, joint.unit, "output", (joint.name, joint.output), ("position", "unknown"), index,
            len(robot.joints), joint.range,
        )
        for index, joint in enumerate(robot.joints)
    ]  # fmt: skip
    ranges = {joint.name: joint.range for joint in robot.joints}
    inputs = [
        Wanted(
            actuator.input, actuator.unit, "input",
            tuple(dict.fromkeys((actuator.joint or actuator.name, actuator.name))), roles[actuator.command], index,
            len(robot.actuators), ranges.get(actuator.joint),
        )
        for index, actuator in enumerate(robot.actuators)
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
        "current",
        "position",
    )
    inputs = [Wanted(signal.name, signal.unit, "input", (signal.name,), commands) for signal in model.inputs]
    measured: tuple[Any, ...] = ("position", "unknown", "velocity", "torque")
    return [
        *inputs,
        *(Wanted(signal.name, signal.unit, "output", (signal.name,), measured) for signal in model.outputs),
    ]


def _left_out(table: LogTable, bad: Sequence[tuple[Piece, str]]) -> list[str]:
    times: dict[str, list[str]] = {}
    for piece, why in bad:
        span = f"{table.time_s[piece.first]:.3f} to {table.time_s[piece.end - 1]:.3f} s"
        times.setdefault(why, []).append(span)
    return [f"left out {', '.join(spans)}: {why}" for why, spans in times.items()]


def _at_rest(table: LogTable, trials: Sequence[Piece]) -> bool:
    """Tell whether every trial begins at rest, judged by its first 0.1 s."""
    period = table.period_s
    count = max(5, round(0.1 / period))
    for index in table.recorded("output"):
        course = table.values[:, index]
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
    free = folder
    while free.exists():
        free = folder.with_name(f"{folder.name}-{number}")
        number += 1
    return free
