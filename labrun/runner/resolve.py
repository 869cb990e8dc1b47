"""From a device's table in the file to what drives it, stands in for it or emulates it, and to the ports it needs."""

import json
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, get_args

from pydantic import BaseModel, ValidationError

from labrun.devices import DeviceSettings, processes
from labrun.devices.clock import RealClock
from labrun.devices.processes.scene import READY, RemoteScene
from labrun.errors import DeviceError, ExperimentError, LabrunError, PluginError, RequestError, SpecError
from labrun.registry import is_installed, load
from labrun.toml import PluginTable, nearest

_DRIVERS = "labrun.devices"
STAND_IN = "simulated-"
"""Begins the name of a stand-in; the rest is the plugin it stands in for."""


@dataclass(frozen=True, slots=True)
class ResolvedDevice:
    """A device's class and its checked settings."""

    name: str
    plugin: str
    make: Any
    settings: DeviceSettings


def _is_driver(plugin: str) -> bool:
    return ":" in plugin or is_installed(_DRIVERS, plugin)


def stand_in_name(plugin: str) -> str:
    """Return the plugin that takes a plugin's place in a dry run.

    A driver whose stand-in is called after it is not imported: a dry run needs nothing of it.
    """
    if plugin.startswith(STAND_IN):
        return plugin
    if is_installed(_DRIVERS, STAND_IN + plugin):
        return STAND_IN + plugin
    if _is_driver(plugin):
        declared = getattr(load(_DRIVERS, plugin), "stand_in", None)
        if isinstance(declared, str):
            return declared
    # A dotted driver that names no stand-in is its own: it is told about the scene, and may use it.
    return plugin if ":" in plugin else STAND_IN + plugin


def resolve_device(name: str, table: PluginTable, *, dry_run: bool) -> ResolvedDevice:
    """Find a device's class and check its settings.

    Raises
    ------
    RequestError
        There is no driver for this hardware here.
    PluginError
        Unknown plugin, or one that does not import.
    SpecError
        Its settings do not hold.
    """
    plugin = stand_in_name(table.plugin) if dry_run else table.plugin
    if not dry_run and not _is_driver(plugin) and is_installed(_DRIVERS, STAND_IN + plugin):
        port = table.settings.get("port")
        where = f" at {port}" if port else ""
        raise RequestError(
            f"device {name}{where}: driver {plugin!r} is not installed, only its simulated device "
            f"{STAND_IN + plugin!r}",
            hint="--dry-run works without it; install the driver's package to run the bench",
        )
    if dry_run and not _is_driver(plugin) and plugin != table.plugin:
        load(_DRIVERS, table.plugin)  # an unknown plugin is named as the person wrote it
        raise PluginError(
            f"device {name}: {table.plugin!r} has no stand-in {plugin!r}, so a dry run cannot simulate it",
            hint="a driver names its stand-in in the class attribute stand_in",
        )
    make = load(_DRIVERS, plugin)
    return ResolvedDevice(name, plugin, make, check_settings(name, make, table.settings))


def check_settings(name: str, make: Any, settings: Mapping[str, Any]) -> DeviceSettings:
    """Validate the settings of a device; SpecError names every invalid key."""
    model: type[DeviceSettings] = getattr(make, "Settings", DeviceSettings)
    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        problems = []
        for item in error.errors():
            key = ".".join(str(part) for part in ("rig.devices", name, *item["loc"]))
            # The shared key of all stand-ins: a driver has no faults to play.
            alone = item["type"] == "extra_forbidden" and item["loc"][-1] == "faults"
            problems.append(
                f"{key}: {'only a dry run plays faults' if alone else item['msg']} (found {item['input']!r})"
            )
        raise SpecError(
            "\n".join(problems), hint=f"keys it knows: {', '.join(sorted(model.model_fields))}"
        ) from error


_SERIAL = ("/dev/", "COM", "\\\\.\\COM")


def port_of(settings: BaseModel) -> str | None:
    """Return the serial port a device's settings name; None for a network address or no port at all."""
    return next(iter(_serial_ports(settings)), None)


def ports_of(settings: BaseModel) -> list[str]:
    """Return what only one run at a time may use: every port of a device's settings, serial or not, and its host."""
    names: list[str] = []
    for name, field in type(settings).model_fields.items():
        if name in ("port", "host") or "port" in field.metadata or _holds_port(field.annotation):
            value = getattr(settings, name)
            names += [value] if isinstance(value, str) else value if isinstance(value, list | tuple) else []
    return [port for port in names if isinstance(port, str) and port]


def _holds_port(annotation: Any) -> bool:
    """Tell whether a type is `Port`, or made of it: ``Port | None``, ``tuple[Port, ...]``."""
    marks = getattr(annotation, "__metadata__", ())
    return "port" in marks or any(_holds_port(part) for part in get_args(annotation))


def _serial_ports(settings: BaseModel) -> list[str]:
    return [port for port in ports_of(settings) if port.startswith(_SERIAL)]


def existing_ports() -> list[str]:
    """Return the serial ports of this machine."""
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports())


def missing_ports(settings: Mapping[str, BaseModel]) -> list[str]:
    """Return one sentence for every serial port of a device that does not exist."""
    problems = []
    for device, table in settings.items():
        for port in _serial_ports(table):
            if Path(port).exists():
                continue
            there = existing_ports()
            near = nearest(port, there, cutoff=0.8)
            known = (
                f"ports of this machine: {', '.join(there)}" if there else "this machine has no serial port"
            )
            text = f"; {near} is there" if near else ""
            problems.append(f"device {device}: port {port} does not exist{text} ({known})")
    return problems


_EMULATORS = "labrun.emulators"
_PYTHON = sys.executable
_START_S = 60.0
"""Compiling a scene for the first time takes the longest part of it."""
_END_S = 5.0
_LOOK_S = 0.005
_SCENE_STREAM = 0x5CE
_EMULATOR_STREAM = 0xE31


def has_emulator(plugin: str) -> bool:
    """Tell whether an emulator of a device is installed."""
    return is_installed(_EMULATORS, plugin)


class EmulatedBench:
    """Emulators of a rig's devices, and the simulated bench behind them.

    A device without an emulator is left to its stand-in, which looks at the same bench through `scene`.

    Parameters
    ----------
    scene
        Plugin and settings of the simulated bench.
    seed
        Of the bench and of the emulators.
    faults
        What is wrong from the beginning: device -> fault -> value.

    Attributes
    ----------
    settings
        By device: the keys that lead its driver to its emulator.
    scene
        The simulated bench; None before `open`, or where the rig names none.
    """

    def __init__(
        self,
        devices: Mapping[str, PluginTable],
        scene: PluginTable | None,
        *,
        seed: int,
        faults: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self._devices = dict(devices)
        self._scene_table = scene
        self._seed = seed
        self._faults = faults or {}
        self._folder: Path | None = None
        self._logs: dict[str, Path] = {}
        self._scene_process: subprocess.Popen[bytes] | None = None
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.settings: dict[str, dict[str, Any]] = {}
        self.scene: RemoteScene | None = None

    def __enter__(self) -> Self:
        try:
            self.open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Start the bench and its emulators.

        Raises
        ------
        PluginError, SpecError
            A device has neither emulator nor stand-in, or its settings do not hold.
        ExperimentError
            A process did not start; its message says why.
        """
        tables = {name: table for name, table in self._devices.items() if has_emulator(table.plugin)}
        for name, table in self._devices.items():
            if name not in tables:
                resolve_device(name, table, dry_run=True)  # has a stand-in, or says what is missing
        folder = self._folder = Path(tempfile.mkdtemp(prefix="labrun-"))
        served = None
        if self._scene_table is not None:
            served = {"address": str(folder / "scene"), "key": secrets.token_hex(32)}
            self._start_scene(served)
        for number, (name, table) in enumerate(tables.items()):
            self._processes[name] = self._start_emulator(number, name, table, served)
        for name, process in self._processes.items():
            answer = json.loads(_answer(process, f"the emulator of {name}"))
            if "error" in answer:
                why = answer["error"].removeprefix(f"device {name}: ")
                raise DeviceError(name, f"its emulator did not open: {why}")
            self.settings[name] = answer["settings"]
        if served is not None:
            self.scene = RemoteScene(served["address"], bytes.fromhex(served["key"]))

    def table(self, name: str) -> PluginTable:
        """Return the table of a device for this run: for its emulator, its simulated device, or as stated."""
        table = self._devices[name]
        if name in self.settings:
            return table.model_copy(update=self.settings[name])
        return table.model_copy(update={"plugin": stand_in_name(table.plugin)})

    def inject(self, device: str, fault: str, value: Any = True) -> None:
        """Bring a fault about at a device."""
        self._order(device, {"fault": fault, "value": value})

    def clear(self, device: str, fault: str) -> None:
        """End a fault."""
        self.inject(device, fault, None)

    def log(self, device: str) -> list[dict[str, Any]]:
        """Return the log of a device's emulator so far."""
        written = self._logs[device].read_text()
        whole = written[: written.rfind("\n") + 1]  # the last line may be in the midst of being written
        return [json.loads(line) for line in whole.splitlines()]

    def keep_logs(self, folder: Path) -> None:
        """Have the emulators' logs go on in a folder that stays: ``<device>.jsonl``."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in self._processes:
            path = folder.absolute() / f"{name}.jsonl"
            self._order(name, {"log": str(path)})
            self._wait_for(path, name)
            self._logs[name] = path

    def close(self) -> None:
        """End all processes; never raises."""
        for name, process in self._processes.items():
            if name not in self.settings:  # still starting: nobody has used it, and it hears no order yet
                process.kill()
                continue
            try:
                self._order(name, {"quit": True})
            except LabrunError:
                continue
        for process in self._processes.values():
            _end(process)
        self._processes.clear()
        if self._scene_process is not None:
            self._scene_process.kill()
            _end(self._scene_process)
            self._scene_process = None
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def _wait_for(self, path: Path, name: str) -> None:
        clock = RealClock()
        deadline_s = clock.now() + _END_S
        while not path.exists():
            if clock.now() > deadline_s:
                raise ExperimentError(f"the emulator of {name} does not write {path}", hint="is it writable?")
            clock.sleep(_LOOK_S)

    def _start_scene(self, served: Mapping[str, str]) -> None:
        assert self._scene_table is not None  # noqa: S101  asked by the caller
        task = {
            "plugin": self._scene_table.plugin,
            "settings": self._scene_table.settings,
            "seed": [self._seed, _SCENE_STREAM],
            **served,
        }
        # Kept before it is waited for: whoever presses Ctrl-C meanwhile leaves no process behind.
        process = self._scene_process = _started("scene", task)
        if _answer(process, "the simulated bench").strip() != READY.encode():
            raise ExperimentError("the simulated bench did not start", hint="see its message above")

    def _start_emulator(
        self, number: int, name: str, table: PluginTable, served: Mapping[str, str] | None
    ) -> "subprocess.Popen[bytes]":
        assert self._folder is not None  # noqa: S101  made by the caller
        resolved = resolve_device(name, table, dry_run=True)
        self._logs[name] = self._folder / f"{name}.jsonl"
        task = {
            "name": name,
            "plugin": table.plugin,
            "stand_in": resolved.plugin,
            "settings": resolved.settings.model_dump(mode="json", exclude_unset=True),
            "scene": served,
            "seed": [self._seed, _EMULATOR_STREAM, number],
            "folder": str(self._folder),
            "log": str(self._logs[name]),
            "faults": dict(self._faults.get(name, {})),
        }
        return _started("emulator", task)

    def _order(self, device: str, order: Mapping[str, Any]) -> None:
        process = self._processes.get(device)
        if process is None:
            raise SpecError(f"no emulator of device {device!r} runs")
        try:
            processes.tell(process, order)
        except (OSError, ValueError) as error:
            raise ExperimentError(
                f"the emulator of {device} is gone", hint="see its message above"
            ) from error


def _started(module: str, task: Mapping[str, Any]) -> "subprocess.Popen[bytes]":
    process = processes.start(module, _PYTHON)
    processes.tell(process, task)
    return process


def _answer(process: "subprocess.Popen[bytes]", who: str) -> bytes:
    """Return the line a process says first."""
    line = processes.answer(process, _START_S)
    if not line:
        raise ExperimentError(f"{who} did not start", hint="see its message above")
    return line


def _end(process: "subprocess.Popen[bytes]") -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            try:
                pipe.close()
            except OSError:
                continue
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
