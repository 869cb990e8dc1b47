"""Before a recording: find the zero of the force channels."""

from collections.abc import Mapping

import numpy as np

from labrun.devices import FloatArray, Samples
from labrun.errors import DeviceError, SpecError
from labrun.experiment import Experiment, Tare
from labrun.objectives import make_objective
from labrun.runner.bench import Bench
from labrun.runner.rig import Rig

_FORCE_UNITS = ("N", "N m")


def tared_devices(rule: Tare | None, rig: Rig) -> tuple[str, ...]:
    """Return the devices that are tared: those the rule names, else every sensor of forces or torques."""
    if rule is None:
        return ()
    if rule.devices is None:
        return tuple(n for n, s in rig.sensors.items() if any(c.unit in _FORCE_UNITS for c in s.channels))
    for name in rule.devices:
        if name not in rig.sensors:
            known = ", ".join(rig.sensors) or "none"
            raise SpecError(
                f"trial.tare.devices: {name!r} is not a sensor of this rig", hint=f"sensors: {known}"
            )
    return tuple(rule.devices)


def untared_objectives(experiment: Experiment, rig: Rig) -> list[str]:
    """Return a sentence for each objective that reads a force or torque whose zero nothing finds.

    Objectives that a constant offset does not change are left out, and sensors whose zero is known without a tare (see
    `labrun.devices.Sensor`).
    """
    tared = tared_devices(experiment.trial.tare, rig)
    notes = []
    for name, table in experiment.objectives.items():
        objective = make_objective(name, table)
        if getattr(objective, "offset_free", False):
            continue
        keys = getattr(type(objective), "channel_settings", ())
        channels = [table.channel or "", *(str(table.settings.get(key, "")) for key in keys)]
        notes += [
            f"objective {name} reads {channel}, whose zero is never taken: its offset counts as {name}; "
            "add tare = { duration_s = 1 } to [trial], or name its device in trial.tare.devices"
            for channel in channels
            if channel.partition(".")[0] not in tared and _has_unknown_zero(channel, rig)
        ]
    return notes


def _has_unknown_zero(channel: str, rig: Rig) -> bool:
    """Tell whether "device.channel" is a force or torque that is measured from no known zero."""
    device, _, column = channel.partition(".")
    sensor = rig.sensors.get(device)
    if sensor is None or getattr(sensor, "zero_known", False):
        return False
    return any(info.name == column and info.unit in _FORCE_UNITS for info in sensor.channels)


def tare(bench: Bench, rule: Tare | None) -> dict[str, float]:
    """Average the force and torque channels while nothing moves.

    Returns
    -------
    dict
        ``"device.channel"`` -> offset in the channel's unit. Raw data stay raw: this is subtracted in analysis.

    Raises
    ------
    DeviceError
        A device gave no sample in the time the rule allows.
    """
    if rule is None:
        return {}
    names = tared_devices(rule, bench.rig)
    collected: dict[str, list[FloatArray]] = {name: [] for name in names}

    def collect(blocks: Mapping[str, Samples]) -> None:
        for name, parts in collected.items():
            if len(blocks[name]):
                parts.append(blocks[name].values)

    bench.watch(bench.clock.now() + rule.duration_s, collect)
    offsets: dict[str, float] = {}
    for name, parts in collected.items():
        if not parts:
            raise DeviceError(name, f"gave no sample in the {rule.duration_s:g} s of trial.tare.duration_s")
        mean = np.concatenate(parts).mean(axis=0)
        for channel, value in zip(bench.rig.sensors[name].channels, mean, strict=True):
            if channel.unit in _FORCE_UNITS:
                offsets[f"{name}.{channel.name}"] = float(value)
    return offsets
