"""Stopping servos from a process that has never talked to them: the runner is dead or hangs."""

from labrun.devices import Clock
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.control_table import MOTION, TORQUE_ENABLE, whole
from labrun_plugins.dynamixel.scale import Scale
from labrun_plugins.dynamixel.settings import DynamixelSettings
from labrun_plugins.dynamixel.torque import hold, switch_off


def emergency_stop(name: str, settings: DynamixelSettings, clock: Clock) -> None:
    """Hold every joint where it is, or switch its torque off, as `on_stop` says.

    A servo that its watchdog has stopped already takes no goal, and needs none. One that does not answer is left to
    its watchdog: after this nobody talks on the bus.

    Raises
    ------
    DeviceError
        The port cannot be opened, or a servo does not answer.
    """
    scales = {table.id: Scale.of(table, settings) for table in settings.joints.values()}
    bus = Bus(
        name, settings.port, settings.baud, clock, {t.id: joint for joint, t in settings.joints.items()}
    )
    bus.open()
    try:
        if settings.on_stop == "torque-off":
            switch_off(bus, list(scales))
            bus.require(list(scales), whole(TORQUE_ENABLE))
            return
        silent = hold(bus, scales, None)
        if silent:
            bus.require(silent, MOTION)
            hold(bus, scales, None)
    finally:
        bus.close()
