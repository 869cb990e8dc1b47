"""Logs of PX4 (``.ulg``), by the library pyulog."""

import re
from pathlib import Path

import numpy as np

from labrun.errors import RecordingError, RequestError
from labrun.logs.findings import Statement
from labrun.logs.streams import Column, Stream, column

_INDEXED = re.compile(r"(.+)\[(\d+)\]")


def read_ulg(path: Path) -> list[Stream]:
    """Read every topic with its own stamps; fields of arrays are parts of a vector."""
    try:
        from pyulog import ULog
    except ImportError:
        raise RequestError(f"{path} needs the package pyulog", hint='pip install "labrun[px4]"') from None
    log = ULog(str(path))
    streams = []
    for topic in log.data_list:
        name = f"/{topic.name}" + (f"_{topic.multi_id}" if topic.multi_id else "")
        time_s = (topic.data["timestamp"].astype(np.int64) - int(log.start_timestamp)) * 1e-6
        fields = {
            field: values
            for field, values in topic.data.items()
            if field not in ("timestamp", "timestamp_sample")
        }
        widths: dict[str, int] = {}
        for field in fields:
            if match := _INDEXED.fullmatch(field):
                widths[match[1]] = max(widths.get(match[1], 0), int(match[2]) + 1)
        columns: list[Column] = []
        for field, values in fields.items():
            match = _INDEXED.fullmatch(field)
            numbers = values.astype(np.float64)
            if match:
                columns.append(
                    column(f"{name}/{match[1]}", "", numbers, position=int(match[2]), width=widths[match[1]])
                )
            else:
                columns.append(column(name, field, numbers))
        streams.append(Stream(name, time_s, tuple(columns)))
    if not streams:
        raise RecordingError(f"{path} holds no topics")
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        dropouts = Statement(
            f"{path.name}: {len(log.dropouts)} dropouts of the logger, {lost_s:.3g} s together"
        )
        streams[0] = Stream(streams[0].name, streams[0].time_s, streams[0].columns, findings=(dropouts,))
    return streams
