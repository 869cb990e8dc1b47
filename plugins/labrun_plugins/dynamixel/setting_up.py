"""Bringing a servo into the state the experiment file asks for, and reading back that it is."""

from dataclasses import dataclass, field

from labrun.devices import Clock, DeviceError
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.control_table import (
    BUS_WATCHDOG,
    DRIVE_MODE,
    HARDWARE_ERROR,
    HOMING_OFFSET,
    MAX_POSITION,
    MIN_POSITION,
    MODELS,
    MODES,
    OPERATING_MODE,
    POSITION_D,
    POSITION_I,
    POSITION_P,
    PROFILE_ACCELERATION,
    PROFILE_VELOCITY,
    RETURN_DELAY,
    SHUTDOWN,
    STATUS_LEVEL,
    TEMPERATURE_LIMIT,
    TORQUE_ENABLE,
    VELOCITY_LIMIT,
    WATCHDOG_FIRMWARE,
    Model,
    Register,
    hardware_errors,
)
from labrun_plugins.dynamixel.scale import Scale
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
    """One servo as it was found and as it is now.

    Attributes
    ----------
    joint, id, model, firmware
        Who it is.
    found
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
    found: dict[str, int] = field(default_factory=dict)
    now: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def find_servos(bus: Bus, settings: DynamixelSettings) -> list[Servo]:
    """Return all servos of the file.

    Raises
    ------
    DeviceError
        One does not answer (says who does), is of an unknown model, or cannot measure what the stream shall hold.
    """
    found = {joint: bus.ping(table.id) for joint, table in settings.joints.items()}
    if None in found.values():
        raise _missing(bus, settings, [joint for joint, answer in found.items() if answer is None])
    servos = []
    for joint, answer in found.items():
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

    Raises
    ------
    DeviceError
        No answer, a refusal, a hardware error that a restart does not clear, or a value that does not stay.
    """
    _listen_to(bus, servo)
    _clear_errors(bus, servo, clock)
    servo.found = {register.name: bus.read(servo.id, register) for register in _REMEMBERED}
    wanted = {RETURN_DELAY: settings.return_delay_us // 2, OPERATING_MODE: MODES[settings.operating_mode]}
    if settings.operating_mode == "position":
        wanted |= {MIN_POSITION: scale.bounds[0], MAX_POSITION: scale.bounds[1]}
    changes = {register: value for register, value in wanted.items() if servo.found[register.name] != value}
    if changes and bus.read(servo.id, TORQUE_ENABLE):
        bus.write(servo.id, TORQUE_ENABLE, 0)  # EEPROM is locked while the torque is on
        servo.notes.append("torque switched off to change its set-up")
    # The mode first: it may reset others. Limits that would cross on the way are told apart by their order.
    for register in sorted(changes, key=lambda one: one is not OPERATING_MODE):
        bus.write(servo.id, register, changes[register])
        servo.notes.append(f"{register.name} {servo.found[register.name]} -> {changes[register]}")
    temporary = {PROFILE_ACCELERATION: 0, PROFILE_VELOCITY: 0}
    if settings.position_gains is not None:
        temporary |= dict(zip((POSITION_P, POSITION_I, POSITION_D), settings.position_gains, strict=True))
    for register, value in temporary.items():
        bus.write(servo.id, register, value)
    for register, value in {**wanted, **temporary}.items():
        _read_back(bus, servo, register, value)
    servo.now = {**servo.found, **servo.now}


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
    found = bus.read(servo.id, register)
    if found != value:
        raise DeviceError(
            bus.device,
            f"{bus.who([servo.id])} took {register.name} = {value}, but reads back {found}",
            hint="another servo with the same id, or another program on the bus, writes too",
        )
    servo.now[register.name] = found


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
