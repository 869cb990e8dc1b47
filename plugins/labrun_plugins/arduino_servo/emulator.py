"""RC servos on an emulated board: their shafts turn the simulated bench's joints."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from labrun.devices import Trajectory
from labrun.devices.emulation import EmulatorContext
from labrun_plugins.arduino_servo.emulated_board import ServoBoardEmulator
from labrun_plugins.arduino_servo.settings import KIND, ArduinoServoSettings, Joint, channels_of
from labrun_plugins.simulated.arduino_servo import PulsedShaft


class ArduinoServoEmulator(ServoBoardEmulator):
    """A board with labservo, and a servo on every channel that a joint of the settings names.

    Faults: those of `ServoBoardEmulator` (``overcurrent``), of `EmulatedBoard` (``watchdog``, ``restart``, ``error``,
    ``wrong-id``, ``stale``) and of the wire.
    """

    def __init__(self, name: str, settings: ArduinoServoSettings, context: EmulatorContext) -> None:
        super().__init__(name, context, kind=KIND, channels=len(settings.pins))
        tables = settings.joints or {_only_joint(name, context): Joint()}
        self._servos = {
            channel: (tables[joint], PulsedShaft(joint))
            for joint, channel in channels_of(tables, settings.pins).items()
        }

    def open(self) -> Mapping[str, Any]:
        """Plug it in; return how it is reached."""
        PulsedShaft("warm-up").command(
            0.1, 0.0
        )  # the first call compiles, and the wire must not wait for that
        return super().open()

    def pulsed(self, channel: int, pulse_us: int, now_s: float) -> None:
        """Let the servo of a channel follow its pulse."""
        if channel not in self._servos:
            return
        table, shaft = self._servos[channel]
        motion = shaft.command(float(np.radians(table.servo_deg(pulse_us))), now_s)
        if motion is not None:
            self._turn(shaft.joint, motion, now_s)

    def released(self, channel: int, now_s: float) -> None:
        """Let a servo without pulses stay where it is."""
        if channel in self._servos:
            _, shaft = self._servos[channel]
            self._turn(shaft.joint, shaft.hold(now_s), now_s)

    def _turn(self, joint: str, motion: Trajectory, now_s: float) -> None:
        scene = self.context.scene
        if scene is not None and joint in scene.joints:
            self.bench.do(lambda: scene.drive(joint, motion, now_s))


def _only_joint(name: str, context: EmulatorContext) -> str:
    """Return the joint of a table that names none: the device's name, or the bench's only joint."""
    joints = () if context.scene is None else tuple(context.scene.joints)
    return joints[0] if name not in joints and len(joints) == 1 else name
