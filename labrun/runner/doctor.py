"""What `labrun doctor` looks at: the machine, its clock, its disk, its ports, its plugins."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from labrun.devices import Remark
from labrun.registry import inspect_all

_SLEEP_S = 0.002
_SLEEP_TRIES = 100
_SYNC_TRIES = 20
_USB_SERIAL = Path("/sys/bus/usb-serial/devices")
_GOOD_LATENCY_MS = 2


def examine(results: Path = Path("results"), usb_serial: Path = _USB_SERIAL) -> list[Remark]:
    """Look at everything a bench relies on; changes nothing but a temporary file.

    Parameters
    ----------
    results
        Where runs will be written: its disk is the one measured.
    usb_serial
        Where the kernel lists USB serial adapters.
    """
    return [*_clock(), *_disk(results), *_ports(usb_serial), *_plugins()]


def _clock() -> Iterator[Remark]:
    resolution_s = time.get_clock_info("monotonic").resolution
    late = []
    for _ in range(_SLEEP_TRIES):
        start = time.monotonic()
        time.sleep(_SLEEP_S)  # the very thing measured here: how late this machine wakes up
        late.append(time.monotonic() - start - _SLEEP_S)
    worst_ms = 1e3 * max(late)
    message = (
        f"monotonic, resolution {resolution_s * 1e9:.0f} ns; wakes {1e3 * sorted(late)[len(late) // 2]:.2f} ms late "
        f"(median of {_SLEEP_TRIES}), {worst_ms:.2f} ms at worst"
    )
    if worst_ms > 10:
        advice = (
            "commands at 100 Hz will jitter: close other programs, or use a machine of its own for the bench"
        )
        yield Remark("warning", "clock", message, advice)
    else:
        yield Remark("ok", "clock", message)


def _disk(results: Path) -> Iterator[Remark]:
    folder = next(path for path in (results, *results.absolute().parents) if path.is_dir())
    free_gb = shutil.disk_usage(folder).free / 1e9
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as file:
            start = time.perf_counter()
            for _ in range(_SYNC_TRIES):
                file.write(b"x")
                file.flush()
                os.fsync(file.fileno())
            sync_ms = 1e3 * (time.perf_counter() - start) / _SYNC_TRIES
    except OSError as error:
        yield Remark(
            "problem", "disk", f"{folder}: {error.strerror}", "runs cannot be written here; use --results"
        )
        return
    message = f"{folder}: {free_gb:.0f} GB free, a flush to disk takes {sync_ms:.1f} ms"
    if free_gb < 1:
        yield Remark("problem", "disk", message, "free some space: a night of 7 kHz data needs about 12 GB")
    elif sync_ms > 20:
        yield Remark(
            "warning", "disk", message, "every trial waits for several flushes; a local SSD is quicker"
        )
    else:
        yield Remark("ok", "disk", message)


def _ports(usb_serial: Path) -> Iterator[Remark]:
    from serial.tools import list_ports

    ports = sorted(list_ports.comports(), key=lambda port: port.device)
    if not ports:
        yield Remark("ok", "serial ports", "none; --dry-run needs none")
    for port in ports:
        if not os.access(port.device, os.R_OK | os.W_OK):
            advice = "sudo usermod -aG dialout $USER, then log in again"
            yield Remark(
                "problem", port.device, f"{port.description}: no permission to read and write", advice
            )
            continue
        yield latency(port.device, port.description, usb_serial)


def latency(device: str, description: str, usb_serial: Path = _USB_SERIAL) -> Remark:
    """Return how long the adapter behind a serial port may hold back what it has received."""
    timer = usb_serial / Path(device).resolve().name / "latency_timer"
    try:
        latency_ms = int(timer.read_text())
    except (OSError, ValueError):  # only FTDI adapters have one
        return Remark("ok", device, description)
    message = f"{description}: latency timer {latency_ms} ms"
    if latency_ms > _GOOD_LATENCY_MS:
        advice = f"echo 1 | sudo tee {timer} (a udev rule keeps it): at {latency_ms} ms a 100 Hz stream comes in lumps"
        return Remark("warning", device, message, advice)
    return Remark("ok", device, message)


def _plugins() -> Iterator[Remark]:
    states = inspect_all()
    broken = [state for state in states if state.cause]
    for state in broken:
        yield Remark("problem", f"plugin {state.name}", state.cause, f"it comes from {state.origin}")
    yield Remark("ok", "plugins", f"{len(states) - len(broken)} of {len(states)} import")
