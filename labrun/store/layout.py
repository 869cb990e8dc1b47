"""What stands where in a trial's file: outcome as attributes, one group per device, command, settle."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from labrun.devices.samples import Channel
from labrun.devices.trajectory import Trajectory
from labrun.errors import StoreError
from labrun.store.attributes import Attribute, read_attribute, storable, write_attributes
from labrun.store.hdf5 import Column, Table, write_table
from labrun.store.table import AXIS, HEAD, MIDDLE, TAIL
from labrun.store.trial import SettleCurve, Stream, TrialOutcome

COMMAND = "command"
SETTLE = "settle"
TIMES = ("time_s", "device_time_s", "host_time_s")
RECORD = "record"
"""Group of a packed run with its texts."""
BESIDE = frozenset({COMMAND, SETTLE})
"""Tables of a trial that are no device's."""
RESERVED = BESIDE | {RECORD, AXIS, *HEAD, *MIDDLE, *TAIL}
"""What stands beside the devices in a trial's file or a packed run."""


def check_names(device: str, channels: Sequence[Channel]) -> None:
    """Raise StoreError where a name cannot stand in the file beside the names labrun uses itself."""
    if device in RESERVED or not _fits(device):
        raise StoreError(
            f"a device cannot be stored under the name {device!r}",
            hint=f"choose a name without '/', other than {', '.join(sorted(RESERVED))}",
        )
    _check_columns(f"device {device}: channel", [channel.name for channel in channels])


def check_joints(joints: Iterable[str]) -> None:
    """Raise StoreError where the motion of a joint could not be stored under its name."""
    _check_columns("joint", list(joints))


def _check_columns(what: str, names: Sequence[str]) -> None:
    for name in names:
        if name in TIMES or not _fits(name) or names.count(name) > 1:
            raise StoreError(
                f"{what} {name!r} cannot be stored",
                hint=f"names differ, have no '/', and are none of {', '.join(TIMES)}",
            )


def _fits(name: str) -> bool:
    return bool(name) and "/" not in name and name != "." and storable(name) == name


def write_outcome(group: Any, outcome: TrialOutcome) -> None:
    """Write an outcome as attributes, see `outcome_attributes`."""
    write_attributes(group, outcome_attributes(outcome))


def outcome_attributes(outcome: TrialOutcome) -> dict[str, Attribute]:
    """Return an outcome as attributes: whole as JSON in ``outcome``, and one by one for readers without labrun."""
    single: dict[str, Attribute] = {
        "outcome": outcome.to_json(),
        "index": outcome.index,
        "repeat": outcome.repeat,
        "role": outcome.role,
        "status": outcome.status,
        "reason": outcome.reason,
        "started_s": outcome.started_s,
        "duration_s": outcome.duration_s,
        "attempt": outcome.attempt,
        "discard_cycles": outcome.discard_cycles,
    }
    if outcome.period_s is not None:
        single["period_s"] = outcome.period_s
    single |= {f"condition.{name}": value for name, value in outcome.condition.items()}
    single |= {f"objective.{name}": value for name, value in outcome.objectives.items()}
    return single


def read_outcome(group: Any) -> TrialOutcome:
    """Read what `write_outcome` wrote."""
    return TrialOutcome.from_json(str(read_attribute(group, "outcome")))


def write_rest(group: Any, settle_curve: SettleCurve | None, command: Trajectory | None) -> None:
    """Write what a trial has beside its streams."""
    for table in rest_tables(settle_curve, command):
        write_table(group, table)


def rest_tables(settle_curve: SettleCurve | None, command: Trajectory | None) -> list[Table]:
    """Return what a trial has beside its streams."""
    tables = [] if command is None else [command_table(command)]
    return tables if settle_curve is None else [*tables, settle_table(settle_curve)]


def device_attributes(rate_hz: float, lost: int, saturated: int) -> dict[str, Attribute]:
    """Return the attributes of a device's group."""
    return {"rate_hz": float(rate_hz), "lost": lost, "saturated": saturated}


def device_tare(outcome: TrialOutcome, device: str) -> dict[str, float]:
    """Return one device's tare offsets by channel."""
    prefix = f"{device}."
    return {
        name.removeprefix(prefix): value for name, value in outcome.tare.items() if name.startswith(prefix)
    }


def stream_table(stream: Stream, glitches: int = 0) -> Table:
    """Return a stream as it is stored."""
    times = zip(TIMES, (stream.time_s, stream.device_time_s, stream.host_time_s), strict=True)
    columns = [Column(name, "s", values) for name, values in times]
    for number, channel in enumerate(stream.channels):
        tare = {"tare": float(stream.tare[channel.name])} if channel.name in stream.tare else {}
        columns.append(Column(channel.name, channel.unit, stream.values[:, number], tare))
    attributes = device_attributes(stream.rate_hz, stream.lost, stream.saturated)
    return Table(stream.name, tuple(columns), attributes | {"clock_glitches": glitches})


def stream_of(table: Table) -> Stream:
    """Return a stored stream."""
    times = {column.name: column.values for column in table.columns if column.name in TIMES}
    signals = [column for column in table.columns if column.name not in TIMES]
    count = len(times["time_s"])
    values = np.column_stack([column.values for column in signals]) if signals else np.empty((count, 0))
    return Stream(
        name=table.name,
        channels=tuple(Channel(column.name, column.unit) for column in signals),
        time_s=times["time_s"],
        device_time_s=times["device_time_s"],
        host_time_s=times["host_time_s"],
        values=values,
        rate_hz=float(table.attributes["rate_hz"]),
        lost=int(table.attributes["lost"]),
        saturated=int(table.attributes["saturated"]),
        tare={
            column.name: float(column.attributes["tare"]) for column in signals if "tare" in column.attributes
        },
    )


def command_table(command: Trajectory) -> Table:
    """Return commanded joint angles as they are stored."""
    joints = [
        Column(joint, "rad", angle) for joint, angle in zip(command.joints, command.angle_rad.T, strict=True)
    ]
    attributes: Mapping[str, Attribute] = (
        {} if command.period_s is None else {"period_s": float(command.period_s)}
    )
    return Table(COMMAND, (Column("time_s", "s", command.time_s), *joints), attributes)


def command_of(table: Table) -> Trajectory:
    """Return stored joint angles."""
    time, *joints = table.columns
    angle_rad = (
        np.column_stack([joint.values for joint in joints]) if joints else np.empty((len(time.values), 0))
    )
    period = table.attributes.get("period_s")
    return Trajectory(
        tuple(joint.name for joint in joints),
        time.values,
        angle_rad,
        None if period is None else float(period),
    )


def settle_table(curve: SettleCurve) -> Table:
    """Return a settle curve as it is stored."""
    columns = (
        Column("time_s", "s", curve.time_s),
        Column("spread", curve.unit, curve.spread),
        Column("drift", curve.unit, curve.drift),
    )
    return Table(SETTLE, columns, {"reason": curve.reason})


def settle_of(table: Table) -> SettleCurve:
    """Return a stored settle curve."""
    columns = {column.name: column for column in table.columns}
    return SettleCurve(
        columns["time_s"].values,
        columns["spread"].values,
        columns["drift"].values,
        reason=str(table.attributes["reason"]),
        unit=columns["spread"].unit,
    )
