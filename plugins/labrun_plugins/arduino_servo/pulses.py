"""From joint angles to the pulse widths of the firmware's channels, and back; what leaves its limits is refused."""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from labrun.devices import DeviceError, FloatArray, Limits, Trajectory
from labrun.errors import LimitExceededError
from labrun_plugins.arduino_servo.settings import NEUTRAL_US, Joint

Value = TypeVar("Value")
_HINT = "set limits.angle_deg, so that the plan is refused before anything moves"


class Pulses:
    """Pulse widths of one board's servos.

    Parameters
    ----------
    device
        Its name, for messages.
    tables
        Joint -> servo.
    channels
        Joint -> channel of the firmware.
    limits
        Of the device.
    """

    def __init__(
        self, device: str, tables: Mapping[str, Joint], channels: Mapping[str, int], limits: Limits
    ) -> None:
        self._device = device
        self._tables = dict(tables)
        self._limits = limits
        self.joints = tuple(tables)
        self.channels = dict(channels)
        self.windows_us = {
            joint: table.pulse_window_us(limits.angle_deg) for joint, table in self._tables.items()
        }
        """Least and greatest pulse width of each joint, us."""

    def check(self, trajectory: Trajectory) -> None:
        """Refuse a motion that leaves a limit anywhere.

        Raises
        ------
        LimitExceededError
            It leaves the file's limits.
        DeviceError
            Other joints, or pulse widths that a servo does not take.
        """
        if trajectory.joints != self.joints:
            raise DeviceError(
                self._device,
                f"got a motion of {', '.join(trajectory.joints)}, but drives {', '.join(self.joints)}",
            )
        for excess in self._limits.trajectory_excess(trajectory):
            raise LimitExceededError(
                self._device,
                f"{excess} at {excess.time_s:.3g} s of the motion; nothing was sent",
                hint="change the gait, or the device's limits in the experiment file",
            )
        for joint, angle_rad in zip(self.joints, trajectory.angle_rad.T, strict=True):
            pulse_us = self._tables[joint].exact_pulse_us(np.degrees(angle_rad))
            low_us, high_us = self._tables[joint].pulse_us
            if pulse_us.min() < low_us - 0.5 or pulse_us.max() > high_us + 0.5:
                raise DeviceError(
                    self._device,
                    f"pulses of {pulse_us.min():.0f} to {pulse_us.max():.0f} us for {joint} leave "
                    f"{low_us} to {high_us} us; nothing was sent",
                    hint=_HINT,
                )

    def of(self, angle_rad: FloatArray) -> dict[str, int]:
        """Return the pulse width of each joint for one set-point (rad, in the order of `joints`), us.

        Raises
        ------
        LimitExceededError
            One of them is outside its limits, or not a number: the set-point must not be sent.
        """
        pulses: dict[str, int] = {}
        for joint, angle in zip(self.joints, np.degrees(angle_rad), strict=True):
            exact_us = float(self._tables[joint].exact_pulse_us(angle))
            low_us, high_us = self.windows_us[joint]
            if not low_us - 0.5 <= exact_us <= high_us + 0.5:
                raise LimitExceededError(
                    self._device,
                    f"a set-point of {angle:.4g} deg for {joint} asks for a pulse of {exact_us:.0f} us, outside of "
                    f"{low_us} to {high_us} us; it was not sent",
                    hint=_HINT,
                )
            pulses[joint] = min(max(round(exact_us), low_us), high_us)
        return pulses

    def by_channel(self, values: Mapping[str, Value]) -> dict[int, Value]:
        """Return what belongs to joints by their channels."""
        return {self.channels[joint]: value for joint, value in values.items()}

    def rest_us(self) -> dict[str, int]:
        """Return the pulse width of each joint at zero, or as near to it as its limits allow, us."""
        rest: dict[str, int] = {}
        for joint, table in self._tables.items():
            low_us, high_us = self.windows_us[joint]
            rest[joint] = min(max(round(NEUTRAL_US + table.us_per_deg * table.neutral_deg), low_us), high_us)
        return rest

    def angles_rad(self, pulses_us: Mapping[int, int]) -> dict[str, float]:
        """Return the joint angles that the channels' pulse widths ask for, rad."""
        return {
            joint: float(np.radians(self._tables[joint].angle_deg(pulses_us[channel])))
            for joint, channel in self.channels.items()
        }
