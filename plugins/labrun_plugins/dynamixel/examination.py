"""What `labrun doctor --hardware` looks at: who is at a port, and whether a bus is set up for a bench."""

import statistics
from collections.abc import Iterator, Sequence

from labrun.devices import Clock, DeviceError, Identity
from labrun.devices.protocols import Remark
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.control_table import (
    CLIMATE,
    DRIVE_MODE,
    FAST_FIRMWARE,
    HARDWARE_ERROR,
    HOMING_OFFSET,
    INPUT_VOLTAGE,
    MAX_POSITION,
    MIN_POSITION,
    MODELS,
    MOTION,
    RETURN_DELAY,
    TEMPERATURE,
    TEMPERATURE_LIMIT,
    VOLTAGE_UNIT_V,
    WATCHDOG_FIRMWARE,
    hardware_errors,
)
from labrun_plugins.dynamixel.setting_up import Servo
from labrun_plugins.dynamixel.settings import DynamixelSettings

_PROBED_BAUDS = (1_000_000, 57_600)
_PROBE_S = 0.15
_MEASUREMENTS = 20
_SLOW_S = 0.008
_WARM_C = 10
_REVERSE = 1


def probe(port: str, clock: Clock) -> Identity | None:
    """Ask everybody at a port who is there; None if nobody answers as a Dynamixel does."""
    for baud in _PROBED_BAUDS:
        bus = Bus("probe", port, baud, clock, {})
        try:
            bus.open()
            found = bus.scan(_PROBE_S)
        except DeviceError:
            return None
        finally:
            bus.close()
        if found:
            servos = {f"id {i}": _named(number, firmware) for i, (number, firmware) in sorted(found.items())}
            models = sorted(
                {MODELS[number].name if number in MODELS else "?" for number, _ in found.values()}
            )
            return Identity(f"Dynamixel {', '.join(models)}", details={"baud": str(baud), **servos})
    return None


def remarks(bus: Bus, servos: Sequence[Servo], settings: DynamixelSettings, clock: Clock) -> list[Remark]:
    """Look at an opened bus.

    Raises
    ------
    DeviceError
        A servo does not answer.
    """
    found = [remark for servo in servos for remark in _of_servo(bus, servo)]
    return [*found, *_of_bus(bus, servos, settings, clock)]


def _of_servo(bus: Bus, servo: Servo) -> Iterator[Remark]:
    who = f"{servo.joint} (id {servo.id})"
    yield Remark("ok", who, f"{servo.model.name}, firmware {servo.firmware}")
    delay_us = 2 * servo.found[RETURN_DELAY.name]
    now_us = 2 * servo.now[RETURN_DELAY.name]
    if delay_us != now_us:
        yield Remark("ok", who, f"return delay was {delay_us} us; labrun has set it to {now_us} us")
    elif now_us > 100:
        yield Remark(
            "warning", who, f"return delay {now_us} us: each answer waits for it", "return_delay_us = 0"
        )
    else:
        yield Remark("ok", who, f"return delay {now_us} us")
    if servo.firmware < WATCHDOG_FIRMWARE:
        yield Remark(
            "problem",
            who,
            f"firmware {servo.firmware} has no bus watchdog: it goes on if this computer dies",
            f"update it to {WATCHDOG_FIRMWARE} or later with Dynamixel Wizard",
        )
    elif servo.firmware < FAST_FIRMWARE:
        yield Remark(
            "ok",
            who,
            f"firmware {servo.firmware} knows no fast reads, {FAST_FIRMWARE} does",
        )
    if servo.now[DRIVE_MODE.name] & _REVERSE:
        yield Remark(
            "warning",
            who,
            "its drive mode is reversed, on top of sign in the file",
            "clear bit 0 of Drive Mode, use sign",
        )
    if servo.now[HOMING_OFFSET.name]:
        yield Remark(
            "warning",
            who,
            f"its homing offset is {servo.now[HOMING_OFFSET.name]} counts, on top of neutral_deg in the file",
            "set Homing Offset to 0, use neutral_deg",
        )
    error = bus.read(servo.id, HARDWARE_ERROR)
    if error:
        yield Remark(
            "problem",
            who,
            f"hardware error: {', '.join(hardware_errors(error))}",
            "free it, let it cool down",
        )
    climate = bus.require([servo.id], CLIMATE)[servo.id].data
    temperature, limit = TEMPERATURE.within(CLIMATE, climate), servo.now[TEMPERATURE_LIMIT.name]
    voltage = VOLTAGE_UNIT_V * INPUT_VOLTAGE.within(CLIMATE, climate)
    state = f"{temperature} degC (shuts down at {limit}), {voltage:.1f} V"
    if temperature > limit - _WARM_C:
        yield Remark("warning", who, state, "let it cool down before a long run")
    else:
        yield Remark("ok", who, state)
    low, high = servo.now[MIN_POSITION.name], servo.now[MAX_POSITION.name]
    yield Remark("ok", who, f"position limits in the servo: counts {low} to {high}")


def _of_bus(bus: Bus, servos: Sequence[Servo], settings: DynamixelSettings, clock: Clock) -> Iterator[Remark]:
    ids = [servo.id for servo in servos]
    passed, failed = [], 0
    for _ in range(_MEASUREMENTS):
        start_s = clock.now()
        failed += len(bus.group_read(ids, MOTION)) < len(ids)
        passed.append(clock.now() - start_s)
    median_s = statistics.median(passed)
    kind = "fast sync read" if bus.fast and len(ids) > 1 else "sync read"
    text = f"{kind} of {len(ids)} servos at {settings.baud} bits/s takes {1e3 * median_s:.1f} ms (median)"
    if failed:
        yield Remark(
            "problem",
            "bus",
            f"{failed} of {_MEASUREMENTS} reads were not answered",
            "check cable, plugs and ids",
        )
    if median_s > _SLOW_S:
        yield Remark(
            "warning", "bus", text, "set the adapter's latency timer to 1 ms, and raise baud to 1000000"
        )
    else:
        yield Remark("ok", "bus", text)
    rate_hz = settings.feedback_hz
    if rate_hz and rate_hz * median_s > 0.7:
        yield Remark(
            "warning", "bus", f"feedback_hz = {rate_hz:g} is more than this bus can do", "ask for less"
        )


def _named(number: int, firmware: int) -> str:
    name = MODELS[number].name if number in MODELS else f"model number {number}"
    return f"{name}, firmware {firmware}"
