"""Bringing servos into the state the file asks for; what they say of themselves; what labrun doctor looks at."""

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from labrun.devices import Clock, DeviceError, Health, Identity
from labrun.devices.protocols import Remark
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.control_table import (
    BUS_WATCHDOG,
    CLIMATE,
    COUNT_RAD,
    DRIVE_MODE,
    FAST_FIRMWARE,
    HARDWARE_ERROR,
    HOMING_OFFSET,
    INPUT_VOLTAGE,
    MAX_POSITION,
    MIN_POSITION,
    MODELS,
    MODES,
    MOTION,
    OPERATING_MODE,
    POSITION_D,
    POSITION_I,
    POSITION_P,
    PROFILE_ACCELERATION,
    PROFILE_VELOCITY,
    RETURN_DELAY,
    SHUTDOWN,
    SPEED_UNIT_RAD_S,
    STATUS_LEVEL,
    TEMPERATURE,
    TEMPERATURE_LIMIT,
    TORQUE_ENABLE,
    TRIPPED,
    VELOCITY_LIMIT,
    VOLTAGE_UNIT_V,
    WATCHDOG_FIRMWARE,
    Model,
    Register,
    Scale,
    hardware_errors,
    whole,
)
from labrun_plugins.dynamixel.settings import BAUD_CODES, DynamixelSettings

_RESTART_S = 2.0
_RESTART_STEP_S = 0.1
_SCAN_S = 0.25
_REMEMBERED = (
    RETURN_DELAY, OPERATING_MODE, DRIVE_MODE, HOMING_OFFSET, TEMPERATURE_LIMIT, VELOCITY_LIMIT, MAX_POSITION,
    MIN_POSITION, SHUTDOWN,
)  # fmt: skip


@dataclass
class Servo:
    """One servo as it was before and as it is now.

    Attributes
    ----------
    joint, id, model, firmware
        Who it is.
    initial
        Register name -> value before labrun touched it.
    now
        Register name -> value read back.
    notes
        What was done to it.
    """

    joint: str
    id: int
    model: Model
    firmware: int
    initial: dict[str, int] = field(default_factory=dict)
    now: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def find_servos(bus: Bus, settings: DynamixelSettings) -> list[Servo]:
    """Return all servos of the file.

    Raises DeviceError: one does not answer (says who does), is of an unknown model, or cannot measure what the stream
    shall hold.
    """
    models = {joint: bus.ping(table.id) for joint, table in settings.joints.items()}
    if None in models.values():
        raise _missing(bus, settings, [joint for joint, answer in models.items() if answer is None])
    servos = []
    for joint, answer in models.items():
        assert answer is not None  # noqa: S101  raised above
        number, firmware = answer
        model = MODELS.get(number)
        identity = settings.joints[joint].id
        if model is None:
            raise DeviceError(
                bus.device,
                f"joint {joint} (id {identity}) is of model number {number}, whose units are not known here",
                hint=f"known are {', '.join(known.name for known in MODELS.values())}",
            )
        servos.append(Servo(joint, identity, model, firmware))
        _check_feedback(bus.device, joint, model, settings)
    bus.fast = all(servo.firmware >= 45 for servo in servos)
    return servos


def set_up(bus: Bus, servo: Servo, scale: Scale, settings: DynamixelSettings, clock: Clock) -> None:
    """Write what differs from the file and read it back; torque stays as it is unless EEPROM has to be written.

    Raises DeviceError: no answer, a refusal, a hardware error that a restart does not clear, or a value that does not
    stay.
    """
    _listen_to(bus, servo)
    _clear_errors(bus, servo, clock)
    servo.initial = {register.name: bus.read(servo.id, register) for register in _REMEMBERED}
    wanted = {RETURN_DELAY: settings.return_delay_us // 2, OPERATING_MODE: MODES[settings.operating_mode]}
    if settings.operating_mode == "position":
        wanted |= {MIN_POSITION: scale.bounds[0], MAX_POSITION: scale.bounds[1]}
    changes = {register: value for register, value in wanted.items() if servo.initial[register.name] != value}
    if changes and bus.read(servo.id, TORQUE_ENABLE):
        bus.write(servo.id, TORQUE_ENABLE, 0)  # EEPROM is locked while the torque is on
        servo.notes.append("torque switched off to change its set-up")
    # The mode first: it may reset others. Limits that would cross on the way are told apart by their order.
    for register in sorted(changes, key=lambda change: change is not OPERATING_MODE):
        bus.write(servo.id, register, changes[register])
        servo.notes.append(f"{register.name} {servo.initial[register.name]} -> {changes[register]}")
    temporary = {PROFILE_ACCELERATION: 0, PROFILE_VELOCITY: 0}
    if settings.position_gains is not None:
        temporary |= dict(zip((POSITION_P, POSITION_I, POSITION_D), settings.position_gains, strict=True))
    for register, value in temporary.items():
        bus.write(servo.id, register, value)
    for register, value in {**wanted, **temporary}.items():
        _read_back(bus, servo, register, value)
    servo.now = {**servo.initial, **servo.now}


def _listen_to(bus: Bus, servo: Servo) -> None:
    """Make a servo answer everything, and release it from its watchdog."""
    bus.group_write(STATUS_LEVEL, {servo.id: 2})
    if servo.firmware >= WATCHDOG_FIRMWARE:
        bus.write(servo.id, BUS_WATCHDOG, 0)


def _clear_errors(bus: Bus, servo: Servo, clock: Clock) -> None:
    """Restart a servo that has shut itself down: its torque is off already, and only this clears the error."""
    error = bus.read(servo.id, HARDWARE_ERROR)
    if not error or bus.read(servo.id, TORQUE_ENABLE):
        return
    bus.reboot(servo.id)
    until_s = clock.now() + _RESTART_S
    while True:
        clock.sleep(_RESTART_STEP_S)
        if bus.ping(servo.id) is not None:
            break
        if clock.now() > until_s:
            raise bus.silent([servo.id])
    _listen_to(bus, servo)
    servo.notes.append(f"restarted, it had shut down: {', '.join(hardware_errors(error))}")
    error = bus.read(servo.id, HARDWARE_ERROR)
    if error:
        raise DeviceError(
            bus.device,
            f"{bus.who([servo.id])} has shut down, and a restart does not help: {', '.join(hardware_errors(error))}",
            hint="let it cool down, check its supply and what it carries, then try again",
        )


def _read_back(bus: Bus, servo: Servo, register: Register, value: int) -> None:
    stored = bus.read(servo.id, register)
    if stored != value:
        raise DeviceError(
            bus.device,
            f"{bus.who([servo.id])} took {register.name} = {value}, but reads back {stored}",
            hint="another servo with the same id, or another program on the bus, writes too",
        )
    servo.now[register.name] = stored


def _check_feedback(device: str, joint: str, model: Model, settings: DynamixelSettings) -> None:
    if settings.feedback_hz == 0.0:
        return
    lacking, instead = ("current", "load") if model.current_a is None else ("load", "current")
    if lacking in settings.feedback:
        raise DeviceError(
            device,
            f"the {model.name} of joint {joint} measures {instead}, not {lacking}",
            hint=f'feedback = ["angle", "speed", "{instead}"]',
        )


def _missing(bus: Bus, settings: DynamixelSettings, joints: list[str]) -> DeviceError:
    """Return the error for servos that do not answer, with those that do."""
    who = bus.who([settings.joints[joint].id for joint in joints])
    there = bus.scan(_SCAN_S)
    if not there:
        return DeviceError(
            bus.device,
            f"{who} does not answer, nor does any other servo at {bus.baud} bits/s",
            hint=f"check power and cable; a new servo talks at 57600, others at {', '.join(map(str, BAUD_CODES))}",
        )
    others = ", ".join(
        f"id {identity} ({MODELS[number].name if number in MODELS else f'model {number}'})"
        for identity, (number, _) in sorted(there.items())
    )
    return DeviceError(
        bus.device,
        f"{who} does not answer; what answers at {bus.baud} bits/s: {others}",
        hint="compare joints.<joint>.id with the servos, and check the plug of the silent one",
    )


def identity(servos: Sequence[Servo], settings: DynamixelSettings) -> Identity:
    """Return who they are; a Dynamixel has no serial number, its id on the bus is all that tells it from others."""
    details = {
        "baud": str(settings.baud),
        "count_rad": repr(COUNT_RAD),
        "speed_unit_rad_s": repr(SPEED_UNIT_RAD_S),
        "command_hz": f"{settings.command_hz:g}",
        "feedback_hz": f"{settings.feedback_hz:g}",
        "operating_mode": settings.operating_mode,
        "on_stop": settings.on_stop,
        "watchdog_ms": str(settings.watchdog_ms),
    }
    for servo in servos:
        table = settings.joints[servo.joint]
        own = {
            "id": servo.id,
            "model": servo.model.name,
            "firmware": servo.firmware,
            "sign": table.sign,
            "neutral_deg": table.neutral_deg,
            "current_unit_a": servo.model.current_a
            if servo.model.current_a is not None
            else "none, it measures load",
            "return_delay_us": 2 * servo.now[RETURN_DELAY.name],
            "drive_mode": servo.now[DRIVE_MODE.name],
            "homing_offset": servo.now[HOMING_OFFSET.name],
            "set_up": "; ".join(servo.notes),
        }
        details |= {f"{servo.joint}.{key}": str(value) for key, value in own.items()}
    models = sorted({servo.model.name for servo in servos})
    firmware = sorted({str(servo.firmware) for servo in servos})
    return Identity(f"Dynamixel {', '.join(models)}", "", ", ".join(firmware), details)


def health(bus: Bus, servos: Sequence[Servo], *, energised: bool) -> Health:
    """Ask all servos how they are.

    `energised`: whether their torque should be on. Raises DeviceError: one does not answer.
    """
    ids = [servo.id for servo in servos]
    guarded = [servo.id for servo in servos if servo.firmware >= WATCHDOG_FIRMWARE]
    climate = bus.require(ids, CLIMATE)
    errors = bus.require(ids, whole(HARDWARE_ERROR))
    torque = bus.require(ids, whole(TORQUE_ENABLE))
    watchdog = bus.require(guarded, whole(BUS_WATCHDOG)) if guarded else {}
    notes, bad = [], []
    for servo in servos:
        error = HARDWARE_ERROR.decode(errors[servo.id].data)
        if error or errors[servo.id].alert:
            bad.append(f"{servo.joint}: {', '.join(hardware_errors(error)) or 'alert'}")
        elif energised and servo.id in watchdog and BUS_WATCHDOG.decode(watchdog[servo.id].data) == TRIPPED:
            bad.append(f"{servo.joint}: stopped by its watchdog, because no command came")
        elif energised and not TORQUE_ENABLE.decode(torque[servo.id].data):
            bad.append(f"{servo.joint}: its torque is off, though nobody here switched it off")
        notes.append(
            f"{servo.joint} {_temperature(climate[servo.id])} degC, {_voltage(climate[servo.id]):.1f} V"
        )
    hottest = max(_temperature(status) for status in climate.values())
    return Health(ok=not bad, temperature_c=float(hottest), notes=(*bad, *notes))


def shut_down(bus: Bus, identity_: int) -> DeviceError:
    """Return the error for a servo whose answers carry Alert."""
    error = bus.read(identity_, HARDWARE_ERROR)
    torque = bus.read(identity_, TORQUE_ENABLE)
    reasons = ", ".join(hardware_errors(error)) or "it does not say why"
    return DeviceError(
        bus.device,
        f"{bus.who([identity_])} reports a hardware error ({reasons}){'' if torque else ' and has shut down'}",
        hint="free it, let it cool down, check its supply; labrun restarts it when the bench is opened again",
    )


def _temperature(status: Status) -> int:
    return TEMPERATURE.within(CLIMATE, status.data)


def _voltage(status: Status) -> float:
    return VOLTAGE_UNIT_V * INPUT_VOLTAGE.within(CLIMATE, status.data)


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
            scanned = bus.scan(_PROBE_S)
        except DeviceError:
            return None
        finally:
            bus.close()
        if scanned:
            servos = {
                f"id {i}": _named(number, firmware) for i, (number, firmware) in sorted(scanned.items())
            }
            models = sorted(
                {MODELS[number].name if number in MODELS else "?" for number, _ in scanned.values()}
            )
            return Identity(f"Dynamixel {', '.join(models)}", details={"baud": str(baud), **servos})
    return None


def remarks(bus: Bus, servos: Sequence[Servo], settings: DynamixelSettings, clock: Clock) -> list[Remark]:
    """Look at an opened bus. Raises DeviceError: a servo does not answer."""
    checks = [remark for servo in servos for remark in _of_servo(bus, servo)]
    return [*checks, *_of_bus(bus, servos, settings, clock)]


def _of_servo(bus: Bus, servo: Servo) -> Iterator[Remark]:
    who = f"{servo.joint} (id {servo.id})"
    yield Remark("ok", who, f"{servo.model.name}, firmware {servo.firmware}")
    delay_us = 2 * servo.initial[RETURN_DELAY.name]
    now_us = 2 * servo.now[RETURN_DELAY.name]
    if delay_us != now_us:
        yield Remark("ok", who, f"return delay was {delay_us} us; labrun has set it to {now_us} us")
    else:
        waits = ": each answer waits for it" if now_us > 100 else ""
        yield Remark.judged(not waits, who, f"return delay {now_us} us{waits}", "return_delay_us = 0")
    if servo.firmware < WATCHDOG_FIRMWARE:
        yield Remark(
            "problem",
            who,
            f"firmware {servo.firmware} has no bus watchdog: it keeps moving if this computer dies",
            f"update it to {WATCHDOG_FIRMWARE} or later with Dynamixel Wizard",
        )
    elif servo.firmware < FAST_FIRMWARE:
        yield Remark("ok", who, f"firmware {servo.firmware} knows no fast reads, {FAST_FIRMWARE} does")
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
    yield Remark.judged(temperature <= limit - _WARM_C, who, state, "let it cool down before a long run")
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
    advice = "set the adapter's latency timer to 1 ms, and raise baud to 1000000"
    yield Remark.judged(median_s <= _SLOW_S, "bus", text, advice)
    rate_hz = settings.feedback_hz
    if rate_hz and rate_hz * median_s > 0.7:
        yield Remark(
            "warning", "bus", f"feedback_hz = {rate_hz:g} is more than this bus can do", "ask for less"
        )


def _named(number: int, firmware: int) -> str:
    name = MODELS[number].name if number in MODELS else f"model number {number}"
    return f"{name}, firmware {firmware}"
