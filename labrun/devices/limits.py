"""Limits of a device: declared in the file, checked on the plan, and again on every command and sample."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from labrun.arrays import FloatArray
from labrun.devices.samples import Channel
from labrun.devices.trajectory import Trajectory
from labrun.errors import DeviceError, LimitExceededError

_TOLERANCE = 1e-9
"""Relative: a command of exactly 60 deg is inside a limit of 60 deg after conversion to radians."""

Positive = Annotated[float, Field(gt=0)]
Temperature = Annotated[float, Field(gt=0, le=200)]
"""An upper bound, degC: no servo lives above 200 degC, and no bench runs below freezing."""


@dataclass(frozen=True, slots=True)
class Excess:
    """A limit violation: what, and by how much, in the unit of the file."""

    quantity: str
    value: float
    bound: float
    unit: str
    time_s: float

    def __str__(self) -> str:
        if math.isnan(self.value):
            return f"{self.quantity} is not a number; its limit is {self.bound:.4g} {self.unit}"
        side = "above" if self.value > self.bound else "below"
        return f"{self.quantity} {self.value:.4g} {self.unit} is {side} the limit of {self.bound:.4g} {self.unit}"


class Limits(BaseModel):
    """Limits on commands and measurements of a device; an absent limit is not checked."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    angle_deg: tuple[float, float] | None = None
    speed_deg_s: Positive | None = None
    force_n: Positive | None = None
    torque_n_m: Positive | None = None
    temperature_c: Temperature | None = None
    speed_m_s: Positive | None = None
    travel_m: tuple[float, float] | None = None

    @field_validator("angle_deg", "travel_m")
    @classmethod
    def _ordered(cls, pair: tuple[float, float] | None) -> tuple[float, float] | None:
        if pair is not None and not pair[0] < pair[1]:
            raise ValueError(f"expected [low, high]; {pair[0]:g} is not below {pair[1]:g}")
        return pair

    def trajectory_excess(self, trajectory: Trajectory) -> Iterator[Excess]:
        """Yield the limit violations of a motion: one per joint and limit, at its worst moment."""
        if self._inside(trajectory):
            return
        for joint, angle_rad in zip(trajectory.joints, trajectory.angle_rad.T, strict=True):
            angle_deg = np.degrees(angle_rad)
            if self.angle_deg is not None:
                yield from _outside(f"angle of {joint}", angle_deg, self.angle_deg, "deg", trajectory.time_s)
            if self.speed_deg_s is not None and len(angle_deg) > 1:
                speed = np.diff(angle_deg) / np.diff(trajectory.time_s)
                bounds = (-self.speed_deg_s, self.speed_deg_s)
                yield from _outside(f"speed of {joint}", speed, bounds, "deg/s", trajectory.time_s[:-1])

    def require_motion(self, device: str, trajectory: Trajectory) -> None:
        """Refuse a motion that leaves a limit. Raises LimitExceededError: nothing of it may be sent."""
        for excess in self.trajectory_excess(trajectory):
            raise LimitExceededError(
                device,
                f"{excess} at {excess.time_s:.3g} s of the motion; nothing was sent",
                hint="change the gait, or the device's limits in the experiment file",
            )

    def _inside(self, trajectory: Trajectory) -> bool:
        """Tell whether a motion surely keeps every limit; nearly all do, and need no look at each joint."""
        angle_deg = np.degrees(trajectory.angle_rad)
        if angle_deg.size == 0:
            return False
        if self.angle_deg is not None:
            low, high = self.angle_deg
            if not (angle_deg.min() >= low and angle_deg.max() <= high):
                return False
        if self.speed_deg_s is not None and len(angle_deg) > 1:
            time_s = trajectory.time_s
            speed = np.abs((angle_deg[1:] - angle_deg[:-1]) / (time_s[1:] - time_s[:-1])[:, None])
            return bool(speed.max() <= self.speed_deg_s)
        return True

    def sample_excess(
        self, channels: tuple[Channel, ...], time_s: FloatArray, values: FloatArray
    ) -> Iterator[Excess]:
        """Yield the limit violations of samples: forces and torques by unit, at their worst sample."""
        if len(values) == 0:
            return
        bounds = {"N": self.force_n, "N m": self.torque_n_m, "degC": self.temperature_c}
        for channel, column in zip(channels, values.T, strict=True):
            bound = bounds.get(channel.unit)
            if bound is not None:
                yield from _outside(channel.name, column, (-bound, bound), channel.unit, time_s)

    def travel_excess(self, to_m: float, speed_m_s: float) -> Iterator[Excess]:
        """Yield the limit violations of a carriage move."""
        if self.travel_m is not None:
            yield from _outside("travel", np.array([to_m]), self.travel_m, "m", np.zeros(1))
        if self.speed_m_s is not None:
            yield from _outside(
                "speed", np.array([speed_m_s]), (-self.speed_m_s, self.speed_m_s), "m/s", np.zeros(1)
            )

    def require_move(self, device: str, to_m: float, speed_m_s: float) -> None:
        """Refuse a carriage's move that must not be sent.

        Raises
        ------
        LimitExceededError
            It leaves a limit.
        DeviceError
            Not numbers, or a speed that is not positive.
        """
        if not (math.isfinite(to_m) and math.isfinite(speed_m_s) and speed_m_s > 0):
            raise DeviceError(
                device,
                f"cannot travel to {to_m:g} m at {speed_m_s:g} m/s; the speed must be above zero",
                hint="change trial.carriage",
            )
        for excess in self.travel_excess(to_m, speed_m_s):
            raise LimitExceededError(
                device,
                f"{excess}; the move was not sent",
                hint="change trial.carriage, or the device's limits",
            )


def _outside(
    quantity: str, values: FloatArray, bounds: tuple[float, float], unit: str, time_s: FloatArray
) -> Iterator[Excess]:
    low, high = bounds
    slack = _TOLERANCE * max(abs(low), abs(high))
    excess = np.maximum(values - high, low - values)
    # What is not a number cannot be shown to be inside: it counts as the worst of all.
    excess = np.where(np.isnan(excess), math.inf, excess)
    worst = int(np.argmax(excess))
    if excess[worst] > slack:
        value = float(values[worst])
        yield Excess(quantity, value, high if value > high else low, unit, float(time_s[worst]))
