"""Whether the ports of a run on hardware are there, before anything is opened."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from labrun.toml import nearest

_SERIAL = ("/dev/", "COM", "\\\\.\\COM")


def port_of(settings: BaseModel) -> str | None:
    """Return the serial port a device's settings name; None for a network address or no port at all."""
    return next(iter(_serial_ports(settings)), None)


def ports_of(settings: BaseModel) -> list[str]:
    """Return what only one run at a time may use: every port of a device's settings, serial or not, and its host."""
    found: list[str] = []
    for name, field in type(settings).model_fields.items():
        if name in ("port", "host") or "port" in field.metadata or _holds_port(field.annotation):
            value = getattr(settings, name)
            found += [value] if isinstance(value, str) else value if isinstance(value, list | tuple) else []
    return [port for port in found if isinstance(port, str) and port]


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
            beside = f"; {near} is there" if near else ""
            problems.append(f"device {device}: port {port} does not exist{beside} ({known})")
    return problems
