"""A new experiment file for some devices: commented, and such that it checks and dry-runs as it stands."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any, Literal

from labrun import registry
from labrun.errors import RequestError
from labrun.experiment.loading import loads_experiment
from labrun.experiment.plugins import examine
from labrun.experiment.raw import DeviceInfo
from labrun.toml import suggest

Kind = Literal["run", "sweep", "cmaes", "track"]
_FORCES = ("force", "torque")
_TEMPLATE = Path(__file__).with_name("new_experiment.toml.j2")


@dataclass
class _Bench:
    """What the devices of a new file drive and measure."""

    tables: dict[str, str] = field(default_factory=dict)
    infos: dict[str, DeviceInfo] = field(default_factory=dict)
    limits: dict[str, dict[str, Any]] = field(default_factory=dict)
    attended: bool = False

    @property
    def joints(self) -> dict[str, str]:
        """The device of every joint."""
        return {joint: device for device, info in self.infos.items() for joint in info.joints}

    @property
    def channels(self) -> list[str]:
        """What is measured, forces first."""
        texts = [f"{device}.{name}" for device, info in self.infos.items() for name in info.channels or ()]
        return sorted(texts, key=lambda channel: not channel.partition(".")[2].startswith(_FORCES))

    @property
    def carriages(self) -> list[str]:
        """Devices that travel, and do nothing else."""
        return [device for device, info in self.infos.items() if info.carriage and not info.joints]


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
        raise RequestError(
            f"{name!r} is not a valid experiment name", hint="letters, digits, - and _: my-arm"
        )
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
    from jinja2 import Environment, StrictUndefined

    bench = _bench(devices)
    channel = next(iter(bench.channels), None)
    values = _greatest(bench)
    _require_something_to_do(kind, devices, values, channel)
    carriage = None
    if bench.carriages:
        limits = bench.limits[bench.carriages[0]]
        low, high = limits.get("travel_m", (0.0, 0.1))
        speed = 0.5 * limits.get("speed_m_s", 0.1)
        carriage = {
            "device": bench.carriages[0],
            "speed": f"{speed:g}",
            "low": f"{low:g}",
            "high": f"{high:g}",
        }
    environment = Environment(  # noqa: S701 - TOML has no markup
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    text = environment.from_string(_TEMPLATE.read_text(encoding="utf-8")).render(
        name=name,
        kind=kind,
        tables=bench.tables,
        joints=bench.joints,
        attended=bench.attended,
        channel=channel,
        forces=channel is not None and channel.partition(".")[2].startswith(_FORCES),
        carriage=carriage,
        **{
            of: {key: _rounded(share * value) for key, value in values.items()}
            for of, share in (("most", 1.0), ("half", 0.5), ("quarter", 0.25))
        },
    )
    loads_experiment(text, name, relative_to=Path(f"{name}.toml"))
    return text


def _require_something_to_do(
    kind: Kind, devices: Sequence[str], values: dict[str, float], channel: str | None
) -> None:
    if not values and kind != "run":
        raise RequestError(
            f"nothing of {', '.join(devices)} moves: a {kind} has nothing to vary",
            hint="--kind run, or an actuator more, such as dynamixel, or operator: a person who moves it",
        )
    if kind == "track" and ("a" not in values or channel is None):
        raise RequestError(
            f"a loop needs something that swings and something that is measured; {', '.join(devices)} is not both",
            hint="an actuator and a sensor, such as dynamixel,ati-netft",
        )
    if kind == "cmaes" and channel is None:
        raise RequestError(
            "a search needs something that is measured, and none of the devices measures",
            hint="add a sensor, such as ati-netft or optitrack",
        )


def _greatest(bench: _Bench) -> dict[str, float]:
    """Return the greatest value of each name that the motion uses."""
    if not bench.joints:
        carriages = bench.carriages
        return {"v": 0.5 * bench.limits[carriages[0]].get("speed_m_s", 0.1)} if carriages else {}
    if bench.attended:
        return {"release": 30.0}
    limits = [bench.limits[device] for device in bench.joints.values()]
    ranges = [limit.get("angle_deg", (-40.0, 40.0)) for limit in limits]
    amplitude = min(10.0, *(0.25 * (high - low) for low, high in ranges))
    speed = min(180.0, *(float(limit.get("speed_deg_s", 180.0)) for limit in limits))
    return {"a": amplitude, "f": min(1.0, 0.8 * speed / (2 * pi * amplitude))}


def _rounded(value: float) -> str:
    """Two digits, never more than the value."""
    text = f"{value:.2g}"
    return text if float(text) <= value else f"{0.95 * value:.2g}"


def _bench(devices: Sequence[str]) -> _Bench:
    bench = _Bench()
    known = [name for name in registry.names("labrun.devices") if not name.startswith("simulated-")]
    for plugin in devices:
        if ":" not in plugin and plugin not in known:
            raise RequestError(
                f"unknown device plugin {plugin!r}", hint=suggest(plugin, known, kind="installed")
            )
        settings = getattr(registry.load("labrun.devices", plugin), "Settings", None)
        keys: str = getattr(settings, "example", "")
        if not keys:
            needed = [
                key for key, info in getattr(settings, "model_fields", {}).items() if info.is_required()
            ]
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
        bench.tables[device], bench.infos[device] = f'plugin = "{plugin}"\n{keys.strip()}', info
        bench.limits[device] = table.get("limits", {})
        loaded = registry.load("labrun.devices", plugin)
        bench.attended |= hasattr(loaded, "arrange") and hasattr(loaded, "follow")
    return bench
