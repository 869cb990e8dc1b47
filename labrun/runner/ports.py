"""Whether the ports of a run on hardware are there, before anything is opened."""

import difflib
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel

_SERIAL = ("/dev/", "COM", "\\\\.\\COM")


def port_of(settings: BaseModel) -> str | None:
    """Return the serial port a device's settings name; None for a network address or no port at all."""
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if (
            (name == "port" or "port" in field.metadata)
            and isinstance(value, str)
            and value.startswith(_SERIAL)
        ):
            return value
    return None


def existing_ports() -> list[str]:
    """Return the serial ports of this machine."""
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports())


def missing_ports(settings: Mapping[str, BaseModel]) -> list[str]:
    """Return one sentence for every device whose serial port does not exist."""
    problems = []
    for device, table in settings.items():
        port = port_of(table)
        if port is None or Path(port).exists():
            continue
        there = existing_ports()
        near = difflib.get_close_matches(port, there, n=1, cutoff=0.8)
        known = f"ports of this machine: {', '.join(there)}" if there else "this machine has no serial port"
        nearest = f"; {near[0]} is there" if near else ""
        problems.append(f"device {device}: port {port} does not exist{nearest} ({known})")
    return problems
