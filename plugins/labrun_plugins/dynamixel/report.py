"""What servos say of themselves: who they are, how they are, and why they have shut down."""

from collections.abc import Sequence

from labrun.devices import DeviceError, Health, Identity
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.control_table import (
    BUS_WATCHDOG,
    CLIMATE,
    COUNT_RAD,
    DRIVE_MODE,
    HARDWARE_ERROR,
    HOMING_OFFSET,
    INPUT_VOLTAGE,
    RETURN_DELAY,
    SPEED_UNIT_RAD_S,
    TEMPERATURE,
    TORQUE_ENABLE,
    TRIPPED,
    VOLTAGE_UNIT_V,
    WATCHDOG_FIRMWARE,
    hardware_errors,
    whole,
)
from labrun_plugins.dynamixel.setting_up import Servo
from labrun_plugins.dynamixel.settings import DynamixelSettings


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

    Parameters
    ----------
    bus, servos
        Whom to ask.
    energised
        Whether their torque should be on.

    Raises
    ------
    DeviceError
        One does not answer.
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
