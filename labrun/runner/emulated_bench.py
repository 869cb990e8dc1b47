"""The emulated bench: the scene's process and one process an emulator, started and ended together."""

import json
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labrun.devices import processes
from labrun.devices.clock import RealClock
from labrun.devices.processes.scene import READY, RemoteScene
from labrun.errors import DeviceError, ExperimentError, LabrunError, SpecError
from labrun.registry import is_installed
from labrun.runner.resolve import resolve_device, stand_in_name
from labrun.toml import PluginTable

_GROUP = "labrun.emulators"
_PYTHON = sys.executable
_START_S = 60.0
"""Compiling a scene for the first time takes the longest part of it."""
_END_S = 5.0
_LOOK_S = 0.005
_SCENE_STREAM = 0x5CE
_EMULATOR_STREAM = 0xE31


def has_emulator(plugin: str) -> bool:
    """Tell whether an emulator of a device is installed."""
    return is_installed(_GROUP, plugin)


class EmulatedBench:
    """Emulators of a rig's devices, and the simulated bench behind them.

    A device without an emulator is left to its stand-in, which looks at the same bench through `scene`.

    Parameters
    ----------
    devices
        The rig's tables, by device.
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        """Return a device's table as its driver gets it here: led to its emulator, or its stand-in's."""
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
        """Return what a device's emulator has witnessed so far."""
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
            raise ExperimentError("the simulated bench did not start", hint="its own message stands above")

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
                f"the emulator of {device} is gone", hint="its own message stands above"
            ) from error


def _started(module: str, task: Mapping[str, Any]) -> "subprocess.Popen[bytes]":
    process = processes.start(module, _PYTHON)
    processes.tell(process, task)
    return process


def _answer(process: "subprocess.Popen[bytes]", who: str) -> bytes:
    """Return the line a process says first."""
    line = processes.answer(process, _START_S)
    if not line:
        raise ExperimentError(f"{who} did not start", hint="its own message stands above")
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
