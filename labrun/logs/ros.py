"""ROS bags of either generation, and MCAP, by the library rosbags."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labrun.errors import RecordingError, RequestError
from labrun.logs.findings import Statement
from labrun.logs.streams import Column, Stream, column, vector

_STATES = ("JointState",)
_TRAJECTORIES = ("JointTrajectory",)
_CONTROLLERS = ("JointTrajectoryControllerState",)
_ARRAYS = ("Float64MultiArray", "Float32MultiArray", "Float64", "Float32")
_KINDS = (*_STATES, *_TRAJECTORIES, *_CONTROLLERS, *_ARRAYS)
_PARTS = {"position": "rad", "velocity": "", "effort": "", "reference": "rad", "command": "rad"}


@dataclass
class _Writer:
    """The messages of one topic by one writer, about the same joints in the same order.

    Attributes
    ----------
    order
        Number of each message among those of its topic.
    received_s, stamped_s
        One for each message; `stamped_s` is not a number where the message has no stamp, and the receipt of the
        trajectory where it is a point of one.
    parts
        Of each part (``position``), the values of all messages one after another.
    """

    names: tuple[str, ...]
    order: "array[int]" = field(default_factory=lambda: array("q"))
    received_s: "array[float]" = field(default_factory=lambda: array("d"))
    stamped_s: "array[float]" = field(default_factory=lambda: array("d"))
    parts: dict[str, "array[float]"] = field(default_factory=dict)

    def add(self, number: int, received_s: float, stamped_s: float, parts: dict[str, Any]) -> None:
        self.order.append(number)
        self.received_s.append(received_s)
        self.stamped_s.append(stamped_s)
        for part, values in parts.items():
            whole = len(values) == len(self.names)
            self.parts.setdefault(part, array("d")).extend(
                map(float, values) if whole else [float("nan")] * len(self.names)
            )


def read_bag(path: Path) -> list[Stream]:
    """Read joint states, trajectories, controllers' states and arrays of numbers; other topics are passed over.

    The joints of a topic are those of all its messages. Joints that no message names together have their own stamps.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise RequestError(f"{path} needs the package rosbags", hint='pip install "labrun[ros]"') from None
    topics: dict[str, dict[Any, _Writer]] = {}
    kinds: dict[str, str] = {}
    passed: dict[str, str] = {}
    empty: dict[str, int] = {}
    count = 0
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            passed = {
                connection.topic: connection.msgtype
                for connection in reader.connections
                if not _kind(connection.msgtype)
            }
            wanted = [connection for connection in reader.connections if _kind(connection.msgtype)]
            zero = reader.start_time
            for connection, stamp, data in reader.messages(connections=wanted):
                kind = kinds[connection.topic] = _kind(connection.msgtype)
                message = reader.deserialize(data, connection.msgtype)
                received_s = (stamp - zero) * 1e-9
                rows = list(_rows(kind, message, received_s, zero))
                empty[connection.topic] = empty.get(connection.topic, 0) + (not rows)
                for names, frame, stamped_s, after_s, parts in rows:
                    writers = topics.setdefault(connection.topic, {})
                    # of ROS 1 each writer has a connection; of ROS 2 joints and frame tell them apart
                    key = (connection.id if _caller(connection) else 0, names, frame)
                    writers.setdefault(key, _Writer(names)).add(count, received_s + after_s, stamped_s, parts)
                    count += 1
    except (AnyReaderError, OSError, ValueError, KeyError) as error:
        hint = "its recorder did not close it: mcap recover" if "magic" in str(error) else None
        raise RecordingError(f"{path} cannot be read as a bag: {error}", hint=hint) from None
    if not topics:
        others = (
            f"; it has {', '.join(f'{topic} ({kind})' for topic, kind in list(passed.items())[:6])}"
            if passed
            else ""
        )
        raise RecordingError(
            f"{path} has no joint states, trajectories or arrays{others}",
            hint="sensor_msgs/JointState, trajectory_msgs/JointTrajectory, std_msgs/Float64MultiArray",
        )
    return [
        stream
        for topic, writers in topics.items()
        for stream in _streams(topic, kinds[topic], list(writers.values()), empty[topic])
    ]


def _kind(msgtype: str) -> str:
    kind = msgtype.rpartition("/")[2]
    return kind if kind in _KINDS else ""


def _caller(connection: Any) -> str:
    return getattr(connection.ext, "callerid", None) or ""


def _rows(
    kind: str, message: Any, received_s: float, zero: int
) -> Iterator[tuple[tuple[str, ...], str, float, float, dict[str, Any]]]:
    """Yield joints, frame, stamp, time after receipt and values by part of what a message says."""
    if kind in _ARRAYS:
        values = np.atleast_1d(np.asarray(message.data, dtype=np.float64))
        if len(values):
            yield tuple(map(str, range(len(values)))), "", float("nan"), 0.0, {"data": values}
        return
    names = tuple(message.name if hasattr(message, "name") else message.joint_names)
    frame = str(message.header.frame_id)
    if not names:
        return
    if kind in _TRAJECTORIES:
        for point in message.points:
            after = point.time_from_start
            yield names, frame, received_s, after.sec + 1e-9 * after.nanosec, {"command": point.positions}
        return
    stamp = message.header.stamp
    stamped_s = (
        (stamp.sec * 10**9 + stamp.nanosec - zero) * 1e-9 if stamp.sec or stamp.nanosec else float("nan")
    )
    if kind in _STATES:
        parts = {"position": message.position, "velocity": message.velocity, "effort": message.effort}
    else:  # control_msgs 4 has renamed them
        parts = {
            "position": _point(message, "feedback", "actual"), "reference": _point(message, "reference", "desired"),
        }  # fmt: skip
    yield names, frame, stamped_s, 0.0, parts


def _point(message: Any, *names: str) -> Any:
    point = next((getattr(message, name) for name in names if hasattr(message, name)), None)
    return getattr(point, "positions", ())


def _streams(topic: str, kind: str, writers: Sequence[_Writer], empty: int) -> Iterator[Stream]:
    """Yield a stream for all writers that name a joint together, in the order of receipt."""
    groups = _groups(writers)
    findings = []
    if empty:
        findings.append(Statement(f"{topic}: {empty} message{'s' * (empty != 1)} without a joint or value"))
    joints = {name for writer in writers for name in writer.names}
    partial = [writer for writer in writers if set(writer.names) != joints]
    if partial and kind not in _ARRAYS:
        most = max(writers, key=lambda writer: len(writer.order))
        findings.append(
            Statement(
                f"{topic}: its messages name {len({frozenset(writer.names) for writer in writers})} different sets of "
                f"joints, {len(joints)} together ({', '.join(sorted(joints)[:8])}); most often "
                f"{', '.join(most.names[:8])}"
            )
        )
    for index, group in enumerate(groups):
        stream = _joined(topic, kind, group)
        yield Stream(
            stream.name, stream.time_s, stream.columns, stream.received, None, () if index else tuple(findings),
            stream.receipt_s, stream.publisher,
        )  # fmt: skip


def _groups(writers: Sequence[_Writer]) -> list[list[_Writer]]:
    groups: list[tuple[set[str], list[_Writer]]] = []
    for writer in writers:
        names, members = set(writer.names), [writer]
        apart = []
        for other, theirs in groups:
            if other & names:
                names |= other
                members = [*theirs, *members]
            else:
                apart.append((other, theirs))
        groups = [*apart, (names, members)]
    return [members for _, members in groups]


def _joined(topic: str, kind: str, writers: Sequence[_Writer]) -> Stream:
    order = np.concatenate([np.asarray(writer.order) for writer in writers])
    rows = np.argsort(order, kind="stable")
    receipt_s = np.concatenate([np.asarray(writer.received_s) for writer in writers])[rows]
    stamped_s = np.concatenate([np.asarray(writer.stamped_s) for writer in writers])[rows]
    publisher = np.concatenate([np.full(len(writer.order), index) for index, writer in enumerate(writers)])[
        rows
    ]
    names = list(dict.fromkeys(name for writer in writers for name in writer.names))
    columns: list[Column] = []
    for part in dict.fromkeys(part for writer in writers for part in writer.parts):
        table = np.full((len(rows), len(names)), np.nan)
        first = 0
        for writer in writers:
            count = len(writer.order)
            values = np.asarray(writer.parts.get(part, array("d"))).reshape(-1, len(writer.names))
            if len(values) == count:
                table[first : first + count, [names.index(name) for name in writer.names]] = values
            first += count
        table = table[rows]
        if kind in _ARRAYS:
            columns += vector(topic, table)
            continue
        for index, name in enumerate(names):
            if not np.isnan(table[:, index]).all():
                columns.append(column(f"{topic}/{part}", name, table[:, index], unit=_PARTS[part]))
    if kind in _TRAJECTORIES:
        starts_s = np.unique(stamped_s)
        next_s = np.append(starts_s, np.inf)[np.searchsorted(starts_s, stamped_s, side="right")]
        kept = receipt_s < next_s  # a trajectory runs from its receipt until the next one comes
        return Stream(topic, receipt_s, tuple(columns), received=True).at(kept)
    stamped = np.isfinite(stamped_s)
    has_stamps = bool(stamped.all())
    return Stream(
        topic, stamped_s if has_stamps else receipt_s, tuple(columns), not has_stamps, None, (), receipt_s,
        publisher if len(writers) > 1 and kind not in _ARRAYS else None,
    )  # fmt: skip
