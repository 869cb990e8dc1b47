"""What an emulator is: a device seen from the wire, in a process of its own, backed by a simulated bench."""

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from labrun.devices.clock import Clock
from labrun.devices.protocols import Scene

_APPEND = os.O_WRONLY | os.O_APPEND | os.O_CREAT


class Faults:
    """What is wrong at the moment, by name; set from outside while the emulator runs.

    A fault's value says how much of it: a share, a time in s, or how many times (for those that are counted down).
    """

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        self._values: dict[str, Any] = dict(values or {})

    def set(self, name: str, value: Any) -> None:
        """Bring a fault about; None or False ends it."""
        if value is None or value is False:
            self._values.pop(name, None)
        else:
            self._values[name] = value

    def active(self, name: str) -> bool:
        """Tell whether a fault is active, without counting it down."""
        return name in self._values

    def value(self, name: str) -> Any:
        """Return the value of a fault, or None."""
        return self._values.get(name)

    def number(self, name: str) -> float:
        """Return the value of a fault as a number: 0 if inactive, 1 if it has no number."""
        value = self._values.get(name, 0.0)
        return 1.0 if value is True else float(value)

    def take(self, name: str) -> bool:
        """Tell whether a fault occurs now, and count it down; one set to True occurs always."""
        value = self._values.get(name)
        if value is None:
            return False
        if value is True:
            return True
        if value <= 1:
            del self._values[name]
        else:
            self._values[name] = value - 1
        return True


class EmulatorLog:
    """The log of an emulator: one JSON line per event, on the monotonic clock.

    Parameters
    ----------
    path
        File that gets the lines; None keeps them in `lines` alone.
    """

    def __init__(self, path: Path | None, clock: Clock) -> None:
        self._clock = clock
        self._path = path
        self._file = None if path is None else os.open(path, _APPEND, 0o644)
        self.lines: list[dict[str, Any]] = []

    @property
    def path(self) -> Path | None:
        """Where the lines go; None if to no file."""
        return self._path

    def note(self, event: str, **fields: Any) -> None:
        """Write one event."""
        line = {"time_s": self._clock.now(), "event": event, **fields}
        if self._file is None:
            self.lines.append(line)
        else:
            os.write(self._file, json.dumps(line, default=_plain).encode() + b"\n")

    def move(self, path: Path) -> None:
        """Continue in another file, which receives what was written so far."""
        if self._path is None or self._file is None:
            return
        file = os.open(path, _APPEND, 0o644)
        os.write(file, self._path.read_bytes())
        os.close(self._file)
        self._path.unlink(missing_ok=True)
        self._path, self._file = path, file


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, bytes):
        return value.hex(" ")
    return str(value)


@dataclass(frozen=True, slots=True)
class EmulatorContext:
    """What an emulator gets from the bench it is part of.

    Attributes
    ----------
    clock
        Real, and the same in all processes of the machine.
    rng
        The emulator's own generator.
    folder
        Where links to its ports go.
    scene
        The simulated bench that all emulators share.
    faults, log
        What is wrong at the moment, and the witness of what came over the wire.
    """

    clock: Clock
    rng: np.random.Generator
    folder: Path
    scene: Scene | None
    faults: Faults = field(default_factory=Faults)
    log: EmulatorLog = field(kw_only=True)


class Emulator(Protocol):
    """The class an entry point of group ``labrun.emulators`` names; under the name of the driver it stands for.

    It is made as ``make(name, settings, context)`` with the settings of the driver's stand-in, and lives in one
    thread: whoever runs it waits on `files` and calls `step` when one is readable or the time has come.
    """

    def open(self) -> Mapping[str, Any]:
        """Open ports or sockets; return the settings by which the driver reaches it, such as ``{"port": ...}``."""
        ...

    def files(self) -> Sequence[int]:
        """Return the file descriptors to wait on; may change from call to call."""
        ...

    def step(self, now_s: float) -> float:
        """Take what arrived and send what is due, without waiting; return when to be called again at the latest."""
        ...

    def close(self) -> None:
        """Close ports and sockets."""
        ...


NEVER = math.inf
"""What `step` returns if nothing is due."""
