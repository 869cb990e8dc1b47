"""A new experiment file for some devices: commented, and such that it checks and dry-runs as it stands."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any, Literal

from labrun import registry
from labrun.errors import RequestError
from labrun.spec.loading import loads_experiment
from labrun.spec.plugins import examine
from labrun.spec.raw import DeviceInfo
from labrun.toml import suggest

Kind = Literal["run", "sweep", "cmaes", "track"]
_FORCES = ("force", "torque")
_KIND_TABLES: dict[Kind, str] = {
    "run": """\
[run]                                  # conditions one by one
conditions = [{{ {low} }}, {{ {high} }}]
""",
    "sweep": """\
[sweep]                                # all combinations; labrun keys sweep says what else an axis may be
axes = {{ {axes} }}
""",
    "cmaes": """\
[cmaes]                                # a search for the best
variables = {{ {ranges} }}
stop = {{ trials = 60 }}
""",
    "track": """\
[track]                                # a loop sets `a` while the motion runs; see labrun keys track
rate_hz = 20
conditions = [{{ controller = "P" }}, {{ controller = "PI" }}]

[track.loops.loop]
drives     = "a"
range      = [0, {most}]
slew_per_s = {most}
reference  = {{ plugin = "sine", mean = {half}, amplitude = {quarter}, period_s = 5 }}   # in units of the channel
feedback   = {{ plugin = "cycle-average", channel = "{channel}" }}

[track.loops.loop.controllers]         # gains: what `a` changes by for a unit of error
P  = {{ plugin = "pid", p = 1 }}
PI = {{ plugin = "pid", p = 1, i = 0.5 }}
""",
}


_ONE_CONDITION = """\
[run]                                  # nothing is varied: a condition without a name
conditions = [{}]
"""


@dataclass
class _Bench:
    """What the devices of a new file drive and measure."""

    tables: dict[str, str] = field(default_factory=dict)
    infos: dict[str, DeviceInfo] = field(default_factory=dict)
    limits: dict[str, dict[str, Any]] = field(default_factory=dict)
    attended: bool = False


def new_experiment(name: str, devices: Sequence[str], kind: Kind, folder: Path) -> Path:
    """Write an experiment file to start from.

    Parameters
    ----------
    name
        Of the experiment; the file is ``folder/NAME.toml``.
    devices
        Plugins of drivers, such as ``dynamixel``.
    kind
        Of the experiment.

    Returns
    -------
    The file.

    Raises
    ------
    RequestError
        The file is there already, a plugin is not, or there is nothing to vary.
    """
    path = folder / f"{name.removesuffix('.toml')}.toml"
    if Path(name).name != name or not path.stem.replace("-", "").replace("_", "").isalnum():
        raise RequestError(f"{name!r} is no name for an experiment", hint="letters, digits, - and _: my-arm")
    if path.exists():
        raise RequestError(f"{path} is there already", hint="take another name, or remove it")
    text = template(path.stem, devices, kind)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RequestError(f"{path} cannot be written: {error.strerror}") from error
    return path


def template(name: str, devices: Sequence[str], kind: Kind) -> str:
    """Return the text of a new experiment file, which has been checked as every file is."""
    bench = _bench(devices)
    joints = {joint: device for device, info in bench.infos.items() for joint in info.joints}
    tables = [f'[rig.devices.{device}]\nplugin = "{table}' for device, table in bench.tables.items()]
    values, gait = _motion(bench, joints)
    if not values and kind != "run":
        raise RequestError(
            f"nothing of {', '.join(devices)} moves: a {kind} has nothing to vary",
            hint="--kind run, or an actuator more, such as dynamixel, or operator: a person who moves it",
        )
    if kind == "track":
        gait, conditions = _loop(bench, values, gait, devices)
    else:
        conditions = _KIND_TABLES[kind].format(**_spread(values)) if values else _ONE_CONDITION
    parts = [_head(name, kind), *tables, gait, _trial(bench, kind), conditions]
    text = "\n\n".join(part.strip() for part in [*parts, _objective(bench, kind)] if part.strip()) + "\n"
    loads_experiment(text, name, beside=Path(f"{name}.toml"))
    return text


def _bench(devices: Sequence[str]) -> _Bench:
    bench = _Bench()
    known = [one for one in registry.names("labrun.devices") if not one.startswith("simulated-")]
    for plugin in devices:
        if ":" not in plugin and plugin not in known:
            raise RequestError(
                f"there is no device plugin {plugin!r}", hint=suggest(plugin, known, kind="installed")
            )
        settings = getattr(registry.load("labrun.devices", plugin), "Settings", None)
        keys: str = getattr(settings, "example", "")
        if not keys:
            needed = [key for key, one in getattr(settings, "model_fields", {}).items() if one.is_required()]
            keys = "\n".join(f'{key} = ""       # must be given' for key in needed)
        device = plugin.rpartition(":")[2].replace("-", "_").lower()
        while device in bench.tables:
            stem, _, number = device.rpartition("_")
            device = f"{stem}_{int(number) + 1}" if number.isdigit() else f"{device}_2"
        table = tomllib.loads(keys)
        info, faults = examine(device, {"plugin": plugin, **table})
        if faults:
            raise RequestError(
                f"plugin {plugin!r} says too little to write a file for it: {faults[0].message}",
                hint=f"labrun keys {plugin} lists its keys; its Settings may say `example`",
            )
        repeated = set(info.joints) & {joint for other in bench.infos.values() for joint in other.joints}
        if repeated:
            raise RequestError(
                f"two devices would move {', '.join(sorted(repeated))}",
                hint="write the second device by hand",
            )
        bench.tables[device], bench.infos[device] = f'{plugin}"\n{keys}', info
        bench.limits[device] = table.get("limits", {})
        loaded = registry.load("labrun.devices", plugin)
        bench.attended |= hasattr(loaded, "arrange") and hasattr(loaded, "follow")
    return bench


def _head(name: str, kind: Kind) -> str:
    return f"""\
# `labrun check {name} --dry-run` checks this file, `labrun run {name} --dry-run` tries it; `labrun keys trial.settle`
# says what a key takes. Without --dry-run the devices are used: put in their ports, addresses and limits.
title = "{name}: say in a line what is measured"
kind  = "{kind}"

[rig]
# What a dry run simulates. Without it joints follow their commands and sensors read zero and their own noise.
# scene = "arm.xml"                    # an MJCF or URDF file, or the name of a scene (labrun plugins)"""


def _motion(bench: _Bench, joints: dict[str, str]) -> tuple[dict[str, float], str]:
    """Return the greatest values of the names that the motion uses, and the gait."""
    if not joints:
        carriages = _carriages(bench)
        return {"v": 0.5 * bench.limits[carriages[0]].get("speed_m_s", 0.1)} if carriages else {}, ""
    if bench.attended:
        lines = [f'joints.{joint} = {{ angle_deg = "release" }}' for joint in joints]
        head = 'plugin = "release"                     # held at an angle, then let go'
        return {"release": 30.0}, "\n".join(["[gait]", head, *lines])
    amplitudes, speeds = [10.0], [180.0]
    for device in joints.values():
        low, high = bench.limits[device].get("angle_deg", (-40.0, 40.0))
        amplitudes.append(0.25 * (high - low))
        speeds.append(float(bench.limits[device].get("speed_deg_s", 180.0)))
    amplitude = min(amplitudes)
    frequency = min(1.0, 0.8 * min(speeds) / (2 * pi * amplitude))
    lines = [f'joints.{joint} = {{ amplitude_deg = "a", frequency_hz = "f" }}' for joint in joints]
    head = 'plugin = "sine"                        # labrun keys gait.joints lists what each gait takes'
    return {"a": amplitude, "f": frequency}, "\n".join(["[gait]", head, *lines])


def _spread(values: dict[str, float]) -> dict[str, str]:
    """Return the conditions in the words of every kind of table."""
    shown = {name: (_rounded(0.5 * value), _rounded(value)) for name, value in values.items()}
    return {
        "low": ", ".join(f"{name} = {low}" for name, (low, _) in shown.items()),
        "high": ", ".join(f"{name} = {high}" for name, (_, high) in shown.items()),
        "axes": ", ".join(f"{name} = [{low}, {high}]" for name, (low, high) in shown.items()),
        "ranges": ", ".join(
            f"{name} = {{ from = {low}, to = {high} }}" for name, (low, high) in shown.items()
        ),
    }


def _loop(bench: _Bench, values: dict[str, float], gait: str, devices: Sequence[str]) -> tuple[str, str]:
    """Return gait and tables of a loop that sets the amplitude so that what is measured follows a reference."""
    channel = _measured(bench)
    if "a" not in values or channel is None:
        raise RequestError(
            f"a loop needs something that swings and something that is measured; {', '.join(devices)} is not both",
            hint="an actuator and a sensor, such as dynamixel,ati-netft",
        )
    most = values["a"]
    numbers = {"most": most, "half": 0.5 * most, "quarter": 0.25 * most}
    table = _KIND_TABLES["track"].format(
        channel=channel, **{name: _rounded(one) for name, one in numbers.items()}
    )
    return gait.replace('"f"', _rounded(values["f"])), table


def _rounded(value: float) -> str:
    """Two digits, never more than the value."""
    text = f"{value:.2g}"
    return text if float(text) <= value else f"{0.95 * value:.2g}"


def _trial(bench: _Bench, kind: Kind) -> str:
    lines = ["[trial]"]
    lines += (
        ["duration_s = 10"]
        if kind == "track"
        else ["duration_s = 5"]
        if bench.attended or not any(info.joints for info in bench.infos.values())
        else ["cycles = 5", "discard_cycles = 1                     # recorded, and not counted"]
    )
    lines += ["repeats = 2                            # or { min = 3, max = 10, standard_error = { ... } }"]
    forces = [device for device, info in bench.infos.items() if _of_force(info)]
    if forces:
        lines += ["tare = { duration_s = 1 }              # zero of the forces, before each recording"]
        lines += ['settle = { until = "quiet", hold_s = 1, timeout_s = 20 }']
    carriages = _carriages(bench)
    if carriages:
        low, high = bench.limits[carriages[0]].get("travel_m", (0.0, 0.1))
        swept = not any(info.joints for info in bench.infos.values())
        speed = '"v"' if swept else f"{0.5 * bench.limits[carriages[0]].get('speed_m_s', 0.1):g}"
        lines += [
            f'carriage = {{ device = "{carriages[0]}", speed_m_s = {speed}, from_m = {low:g}, to_m = {high:g} }}'
        ]
    return "\n".join(lines)


def _carriages(bench: _Bench) -> list[str]:
    return [device for device, info in bench.infos.items() if info.carriage and not info.joints]


def _of_force(info: DeviceInfo) -> bool:
    return any(channel.startswith(_FORCES) for channel in info.channels or ())


def _measured(bench: _Bench) -> str | None:
    """Return a channel that is measured, of a force if there is one."""
    measured = [
        f"{device}.{channel}" for device, info in bench.infos.items() for channel in info.channels or ()
    ]
    forces = [one for one in measured if one.partition(".")[2].startswith(_FORCES)]
    return next(iter([*forces, *measured]), None)


def _objective(bench: _Bench, kind: Kind) -> str:
    channel = _measured(bench)
    if channel is None:
        if kind == "cmaes":
            raise RequestError(
                "a search needs something that is measured, and none of the devices measures",
                hint="add a sensor, such as ati-netft or optitrack",
            )
        return ""
    goal = ', goal = "maximise"' if kind == "cmaes" else ""
    return f"""\
[objectives]                           # numbers made from the signals; at most one has goal = "maximise" or "minimise"
rms = {{ plugin = "rms", channel = "{channel}"{goal} }}"""
