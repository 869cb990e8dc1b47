"""Switching servos on where they stand, and stopping them."""

from collections.abc import Mapping, Sequence

import numpy as np

from labrun.devices import Clock, DeviceError, FloatArray
from labrun_plugins.dynamixel.bus import Bus
from labrun_plugins.dynamixel.commands import OVERSHOOT_RAD
from labrun_plugins.dynamixel.control_table import (
    BUS_WATCHDOG,
    COUNT_RAD,
    GOAL_POSITION,
    MOTION,
    PRESENT_POSITION,
    PROFILE_ACCELERATION,
    PROFILE_VELOCITY,
    STOP,
    TORQUE_ENABLE,
    TRIPPED,
    whole,
)
from labrun_plugins.dynamixel.report import shut_down
from labrun_plugins.dynamixel.scale import Scale
from labrun_plugins.dynamixel.settings import DynamixelSettings

STOP_WAIT_S = 0.02
"""A stop waits no longer than this for another thread that holds the bus."""
STOP_PATIENCE_S = 0.025
"""... and no longer than this for servos to say where they are. All of it is sent twice: nobody acknowledges it."""


def goals_here(bus: Bus, scales: Mapping[int, Scale], counts: Mapping[int, int]) -> dict[int, int]:
    """Return the goals at which the joints stay where they are, id -> count, inside their limits.

    Raises
    ------
    DeviceError
        A joint stands so far outside that it would jump back.
    """
    goals = {}
    for identity, count in counts.items():
        goals[identity] = scales[identity].inside(count)
        if abs(goals[identity] - count) * COUNT_RAD > OVERSHOOT_RAD:
            angle_deg = np.degrees(scales[identity].angle_rad(count))
            raise DeviceError(
                bus.device,
                f"{bus.who([identity])} stands at {angle_deg:.1f} deg, outside its limits; "
                "its torque stays off, because it would jump back",
                hint="turn it inside by hand, or widen limits.angle_deg",
            )
    return goals


def switch_on(bus: Bus, goals: Mapping[int, int], guarded: Sequence[int], watchdog_steps: int) -> None:
    """Give every servo its goal and its torque, then arm the watchdogs, and read back.

    Raises
    ------
    DeviceError
        A servo does not answer, has shut down, or does not do what it was told.
    """
    ids = list(goals)
    bus.group_write(GOAL_POSITION, goals)
    bus.group_write(TORQUE_ENABLE, dict.fromkeys(ids, 1))
    for identity, status in bus.require(ids, whole(TORQUE_ENABLE)).items():
        if status.alert:
            raise shut_down(bus, identity)
        if TORQUE_ENABLE.decode(status.data) != 1:
            raise DeviceError(
                bus.device,
                f"{bus.who([identity])} does not switch its torque on",
                hint="switch its power off and on; labrun doctor --hardware reads its errors",
            )
    if not guarded:
        return
    for steps in (0, watchdog_steps):
        bus.group_write(BUS_WATCHDOG, dict.fromkeys(guarded, steps))
    for identity, status in bus.require(guarded, whole(BUS_WATCHDOG)).items():
        if BUS_WATCHDOG.decode(status.data) != watchdog_steps:
            raise DeviceError(
                bus.device,
                f"the watchdog of {bus.who([identity])} cannot be armed, or has tripped already",
                hint="raise watchdog_ms, or switch its power off and on",
            )


def check_watchdogs(bus: Bus, guarded: Sequence[int], gap_s: float) -> None:
    """After a pause that was too long, see whether servos have stopped themselves: they would not say so.

    Raises
    ------
    DeviceError
        One has.
    """
    answers = bus.group_read(guarded, whole(BUS_WATCHDOG))
    tripped = [i for i, status in answers.items() if BUS_WATCHDOG.decode(status.data) == TRIPPED]
    if tripped:
        raise DeviceError(
            bus.device,
            f"{bus.who(tripped)} heard nothing for {1e3 * gap_s:.0f} ms and was stopped by its watchdog",
            hint="this computer was too busy: close other programs, or raise watchdog_ms",
        )


def switch_off(bus: Bus, ids: Sequence[int]) -> None:
    """Take the torque away at once, twice, and once more if one kept it; DeviceError if the port is gone."""
    off = dict.fromkeys(ids, 0)
    with bus.urgent():
        bus.group_write(TORQUE_ENABLE, off, wait_s=STOP_WAIT_S)
        bus.group_write(TORQUE_ENABLE, off, wait_s=0.0)
        answers = bus.group_read(ids, whole(TORQUE_ENABLE), wait_s=STOP_WAIT_S)
        if any(TORQUE_ENABLE.decode(status.data) for status in answers.values()):
            bus.group_write(TORQUE_ENABLE, off, wait_s=0.0)


def hold(bus: Bus, scales: Mapping[int, Scale], last_rad: FloatArray | None) -> list[int]:
    """Make the place where the joints are their goal, at once; DeviceError if the port is gone.

    As the servos' own watchdog does, it takes profiles away too, so that none stretches the way to a standstill.

    Parameters
    ----------
    bus, scales
        All servos.
    last_rad : (servos,)
        The last set-point: for a servo that does not say where it is, but may hear.

    Returns
    -------
    list of int
        Servos that did not say where they are.
    """
    with bus.urgent():
        answers = bus.group_read(list(scales), MOTION, wait_s=STOP_WAIT_S, patience_s=STOP_PATIENCE_S)
        here = {i: PRESENT_POSITION.within(MOTION, status.data) for i, status in answers.items()}
        silent = [identity for identity in scales if identity not in here]
        if last_rad is not None:
            angles = dict(zip(scales, last_rad, strict=True))
            here |= {identity: scales[identity].count(float(angles[identity])) for identity in silent}
        profile = PROFILE_ACCELERATION.encode(0) + PROFILE_VELOCITY.encode(0)
        stop = {i: profile + GOAL_POSITION.encode(scales[i].inside(count)) for i, count in here.items()}
        if stop:
            bus.group_write_bytes(STOP, stop, wait_s=0.0)
            bus.group_write_bytes(STOP, stop, wait_s=0.0)
    return silent


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
