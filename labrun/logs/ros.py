"""ROS bags of either generation, and MCAP, by the library rosbags."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from labrun.errors import RecordingError, RequestError
from labrun.logs.streams import Column, Stream, column, vector

_STATES = "JointState"
_TRAJECTORIES = ("JointTrajectory",)
_CONTROLLERS = ("JointTrajectoryControllerState",)
_ARRAYS = ("Float64MultiArray", "Float32MultiArray", "Float64", "Float32")
_OTHER_CLOCK_S = 0.5
"""Stamps further than this from their receipt are of another clock (chosen: a network's delay is far below)."""


def read_bag(path: Path) -> list[Stream]:
    """Read joint states, trajectories, controllers' states and arrays of numbers; other topics are passed over."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise RequestError(f"{path} needs the package rosbags", hint='pip install "labrun[ros]"') from None
    gathered: dict[str, list[tuple[float, Any]]] = {}
    kinds: dict[str, str] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = [one for one in reader.connections if _kind(one.msgtype)]
            zero = reader.start_time
            for connection, stamp, data in reader.messages(connections=wanted):
                kinds[connection.topic] = _kind(connection.msgtype)
                message = reader.deserialize(data, connection.msgtype)
                gathered.setdefault(connection.topic, []).append(((stamp - zero) * 1e-9, message))
    except (AnyReaderError, OSError, ValueError, KeyError) as error:
        hint = "its recorder did not close it: mcap recover" if "magic" in str(error) else None
        raise RecordingError(f"{path} cannot be read as a bag: {error}", hint=hint) from None
    if not gathered:
        raise RecordingError(
            f"{path} has no joint states, trajectories or arrays",
            hint="sensor_msgs/JointState, trajectory_msgs/JointTrajectory, std_msgs/Float64MultiArray",
        )
    return [
        stream
        for topic, messages in gathered.items()
        for stream in _streams(topic, kinds[topic], messages, zero)
    ]


def _kind(msgtype: str) -> str:
    kind = msgtype.rpartition("/")[2]
    return kind if kind in (_STATES, *_TRAJECTORIES, *_CONTROLLERS, *_ARRAYS) else ""


def _streams(topic: str, kind: str, messages: list[tuple[float, Any]], zero: int) -> Iterator[Stream]:
    received = np.array([stamp for stamp, _ in messages])
    said = [message for _, message in messages]
    if kind in _TRAJECTORIES:
        time_s, columns = _points(topic, received, said)
        yield Stream(topic, time_s, tuple(columns), received=True, before_receipt_s=0.0)
        return
    if kind in _ARRAYS:
        values = [np.atleast_1d(np.asarray(message.data, dtype=np.float64)) for message in said]
        width = max(len(one) for one in values)
        kept = [index for index, one in enumerate(values) if len(one) == width]
        numbers = tuple(vector(topic, np.array([values[i] for i in kept])))
        yield Stream(topic, received[kept], numbers, received=True, before_receipt_s=0.0)
        return
    time_s, by_receipt, remarks = _stamps(topic, received, said, zero)
    names = tuple(_names(said[0]))
    parts = _state_parts(said) if kind == _STATES else _controller_parts(said)
    columns = []
    for part, lists in parts.items():
        table = np.array(
            [_ordered(names, message, values) for message, values in zip(said, lists, strict=True)]
        )
        for place, name in enumerate(names):
            if not np.isnan(table[:, place]).all():
                unit = "rad" if part in ("position", "reference") else ""
                columns.append(column(f"{topic}/{part}", name, table[:, place], unit=unit))
    before = float(np.median(received - time_s))
    yield Stream(topic, time_s, tuple(columns), by_receipt, None, remarks, before)


def _state_parts(messages: list[Any]) -> dict[str, list[Any]]:
    return {part: [getattr(one, part) for one in messages] for part in ("position", "velocity", "effort")}


def _controller_parts(messages: list[Any]) -> dict[str, list[Any]]:
    """Return goal and measurement of a controller; ROS 2 has renamed them (control_msgs 4)."""

    def first(message: Any, *names: str) -> Any:
        point = next((getattr(message, name) for name in names if hasattr(message, name)), None)
        return getattr(point, "positions", ())

    return {
        "position": [first(one, "feedback", "actual") for one in messages],
        "reference": [first(one, "reference", "desired") for one in messages],
    }


def _names(message: Any) -> list[str]:
    """Return the joints of a message; controllers call them otherwise than joint states do."""
    return list(message.name if hasattr(message, "name") else message.joint_names)


def _ordered(names: tuple[str, ...], message: Any, values: Any) -> list[float]:
    """Return the values in the order of the first message's names: publishers may change it."""
    own = _names(message)
    if len(values) != len(own):
        return [float("nan")] * len(names)
    by_name = dict(zip(own, values, strict=True))
    return [float(by_name.get(name, float("nan"))) for name in names]


def _stamps(topic: str, received: Any, messages: list[Any], zero: int) -> tuple[Any, bool, tuple[str, ...]]:
    headers: list[Any] = [one.header.stamp for one in messages if hasattr(one, "header")]
    if len(headers) < len(messages) or all(one.sec == 0 and one.nanosec == 0 for one in headers):
        return received, True, ()
    stamps = np.array([(one.sec * 10**9 + one.nanosec - zero) * 1e-9 for one in headers])
    apart = float(np.median(received - stamps))
    if abs(apart) <= _OTHER_CLOCK_S:
        return stamps, False, ()
    told = f"{topic}: its stamps are of a clock {apart:+.3f} s from the recorder's, and were shifted by that"
    return stamps + apart, False, (told,)


def _points(topic: str, received: Any, messages: list[Any]) -> tuple[Any, list[Column]]:
    """Return the goals of trajectories over time: each runs from its receipt until the next one comes."""
    names = tuple(messages[0].joint_names)
    rows: list[tuple[float, list[float]]] = []
    for number, message in enumerate(messages):
        end = received[number + 1] if number + 1 < len(messages) else np.inf
        for point in message.points:
            after = point.time_from_start
            stamp = float(received[number]) + after.sec + 1e-9 * after.nanosec
            if stamp < end:
                rows.append((stamp, _ordered(names, message, point.positions)))
    table = np.array([row for _, row in rows]).reshape(-1, len(names))
    columns = [
        column(f"{topic}/command", name, table[:, place], unit="rad") for place, name in enumerate(names)
    ]
    return np.array([stamp for stamp, _ in rows]), columns
