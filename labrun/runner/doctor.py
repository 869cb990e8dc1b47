"""What `labrun doctor` looks at: the machine, its clock, disk, ports and plugins; and the devices of a rig."""

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from labrun.devices import Clock, Device, Identity, Remark, Samples, Sensor, SerialPort
from labrun.errors import DeviceError, LabrunError, PluginError
from labrun.registry import inspect_all, installed, load
from labrun.runner.resolve import STAND_IN, existing_ports, port_of
from labrun.runner.rig import Rig
from labrun.runner.safety import blaming

_SLEEP_S = 0.002
_SLEEP_TRIES = 100
_SYNC_TRIES = 20
_USB_SERIAL = Path("/sys/bus/usb-serial/devices")
_GOOD_LATENCY_MS = 2


def examine_machine(results: Path = Path("results"), usb_serial: Path = _USB_SERIAL) -> list[Remark]:
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
    advice = "commands at 100 Hz will jitter: close other programs, or use a machine of its own for the bench"
    yield Remark.judged(worst_ms <= 10, "clock", message, advice)


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
    else:
        advice = "every trial waits for several flushes; a local SSD is quicker"
        yield Remark.judged(sync_ms <= 20, "disk", message, advice)


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
    """Return the latency timer of the adapter of a serial port."""
    timer = usb_serial / Path(device).resolve().name / "latency_timer"
    try:
        latency_ms = int(timer.read_text())
    except (OSError, ValueError):  # only FTDI adapters have one
        return Remark("ok", device, description)
    message = f"{description}: latency timer {latency_ms} ms"
    advice = (
        f"echo 1 | sudo tee {timer} (a udev rule keeps it): at {latency_ms} ms a 100 Hz stream comes in lumps"
    )
    return Remark.judged(latency_ms <= _GOOD_LATENCY_MS, device, message, advice)


def _plugins() -> Iterator[Remark]:
    states = inspect_all()
    broken = [state for state in states if state.cause]
    for state in broken:
        yield Remark("problem", f"plugin {state.name}", state.cause, f"it comes from {state.origin}")
    yield Remark("ok", "plugins", f"{len(states) - len(broken)} of {len(states)} import")


_LISTEN_S = 1.0
_RATE_SLACK = 0.02
_GROUP = "labrun.devices"


def examine_rig(rig: Rig) -> Iterator[Remark]:
    """Open each device of a rig in turn, query identity and health, listen for a second, and close it.

    One that fails does not keep the others from being looked at.
    """
    ports = {item.name: port_of(item.settings) for item in rig.resolved}
    for name, device in rig.devices.items():
        port = ports[name]
        if port is not None and Path(port).exists():
            yield latency(port, f"port of {name}")
        try:
            yield from _examine_device(name, device, rig.clock)
        except LabrunError as error:
            yield _problem(name, error)
        finally:
            with suppress(Exception):  # one that cannot be closed keeps no other from being looked at
                device.safe_stop()
                device.close()


def _examine_device(name: str, device: Device, clock: Clock) -> Iterator[Remark]:
    with blaming(name):
        getattr(device, "open_at_rest", device.open)()  # nothing moves because somebody asks how it is
        identity = device.identify()
        yield Remark("ok", name, identity_text(identity))
        health = device.health()
        notes = "; ".join(health.notes)
        if health.ok:
            yield Remark("ok", name, "well" + (f": {notes}" if notes else ""))
        else:
            yield Remark("problem", name, f"reports a fault: {notes or 'no reason given'}", "see its README")
        if isinstance(device, Sensor):
            yield _rate(name, device, clock)
        examine = getattr(device, "examine", None)
        if examine is not None:
            yield from (_about(name, remark) for remark in examine())


def _rate(name: str, sensor: Sensor, clock: Clock) -> Remark:
    """Listen to a sensor for a second, and compare its rate with what it should be."""
    sensor.start()
    sensor.read()
    blocks = []
    until_s = clock.now() + _LISTEN_S
    while clock.now() < until_s:
        clock.sleep(clock.poll_s)
        blocks.append(sensor.read())
    sensor.stop()
    samples = Samples.join(blocks, len(sensor.channels))
    count = len(samples)
    if count < 2:
        advice = "check that it is set to stream, and to whom; its README says how"
        return Remark("problem", name, f"{count} samples in {_LISTEN_S:g} s", advice)
    rate_hz = (count - 1) / max(float(np.ptp(samples.host_time_s)), 1e-9)
    message = (
        f"{rate_hz:.4g} samples/s, {sensor.rate_hz:.4g} asked for; {samples.lost} lost in {_LISTEN_S:g} s"
    )
    if abs(rate_hz / sensor.rate_hz - 1.0) > _RATE_SLACK + 2.0 / count:
        return Remark(
            "warning", name, message, "set rate_hz to what it gives, or look for what slows it down"
        )
    advice = "a busy network, a slow adapter, or a machine with too much to do"
    return Remark.judged(not samples.lost, name, message, advice)


def identity_text(identity: Identity) -> str:
    """Return in a line what answered; its details are kept with each run."""
    parts = [identity.model]
    if identity.serial:
        parts.append(f"serial {identity.serial}")
    if identity.firmware:
        parts.append(f"firmware {identity.firmware}")
    return ", ".join(parts)


def find_devices(ports: list[str] | None = None) -> Iterator[Remark]:
    """Ask at every serial port of this machine which of the known devices answers.

    Devices on a network are not looked for: an experiment file says where they are.

    Parameters
    ----------
    ports
        Instead of all ports of the machine.
    """
    probes = _probes()
    asked = existing_ports() if ports is None else ports
    if not asked:
        yield Remark(
            "warning",
            "serial ports",
            "this machine has none",
            "plug a device in; for devices on a network name the experiment: labrun doctor --hardware EXPERIMENT",
        )
    for port in asked:
        try:
            _require_free(port)
        except DeviceError as error:
            yield _problem(port, error)
            continue
        timer = latency(port, "its adapter")
        if timer.verdict != "ok":
            yield timer
        yield from _ask_at(port, probes)


def _require_free(port: str) -> None:
    """Raise DeviceError if the port is not there, may not be used, or is held by another program."""
    line = SerialPort(port, port, 115_200)
    line.open()
    line.close()


def _ask_at(port: str, probes: Mapping[str, Callable[[str], Identity | None]]) -> Iterator[Remark]:
    """Ask for each kind in turn until one answers. One that cannot ask (no library) keeps no other from asking."""
    silent = []
    for plugin, probe in probes.items():
        try:
            with blaming(port):
                identity = probe(port)
        except LabrunError as error:
            yield replace(_problem(port, error), verdict="warning", subject=f"{port}, {plugin}")
            continue
        if identity is not None:
            yield Remark("ok", port, f"{plugin}: {identity_text(identity)}")
            return
        silent.append(plugin)
    yield Remark(
        "warning",
        port,
        f"nothing answers as {', '.join(silent)}",
        "check its power, its wiring and its baud rate; it may also be something else",
    )


def _probes() -> Mapping[str, Callable[[str], Identity | None]]:
    probes = {}
    for entry in installed(_GROUP):
        if entry.name.startswith(STAND_IN):
            continue
        try:
            probe = getattr(load(_GROUP, entry.name), "probe", None)
        except PluginError:  # told by the look at the plugins
            continue
        if probe is not None:
            probes[entry.name] = probe
    return probes


def _about(name: str, remark: Remark) -> Remark:
    """Return a remark whose subject names the device."""
    if remark.subject.startswith(name):
        return remark
    return replace(remark, subject=f"{name}, {remark.subject}")


def _problem(subject: str, error: LabrunError) -> Remark:
    message = str(error.args[0]).removeprefix(f"device {subject}: ")
    return Remark("problem", subject, message, error.hint or "")
