"""Keys of the stage in the experiment file."""

import math
from typing import ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from labrun.devices import DeviceSettings, Port
from labrun_plugins.linear_stage.calibration import FULL_SCALE_COUNTS, Calibration

FASTEST_MM_S = 10.0
"""Of the firmware: beyond it the steps come too fast for what is checked at each of them."""
_NM = 1e-9
"""Slack when lengths in mm and m are compared."""


class Lever(BaseModel):
    """A joint that the stage bends: the equivalent angle is the displacement over this lever."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    lever_mm: PositiveFloat


class LinearStageSettings(DeviceSettings):
    """What a person may say about the stage; lengths along it count from its lower end switch, where it homes.

    Attributes
    ----------
    port
        The board's serial port, for example ``/dev/ttyACM0``.
    rate_hz
        Samples a second; 10 or 80 as the HX711's RATE pin says, or fewer.
    stroke_mm
        From end switch to end switch.
    zero_mm
        Where displacement is zero: there the pusher touches the beam at rest.
    home_on_open
        Seek the lower end switch when the device is opened and does not know where it is, and go to zero: only where
        nothing stands in the way. Otherwise a stage that is not homed refuses to move.
    joints
        At most one: gaits drive it by its angle, which is displacement over `lever_mm`.
    calibration
        Of the load cell. Without it there are counts, and no forces.
    watchdog_ms
        The board stops by itself when it hears nothing for this long.
    command_rate_hz
        Targets a second while a gait is followed.
    boot_wait_s
        How long the board may take to come up: opening its port resets most boards. 0 for one that it does not reset.
    """

    example: ClassVar[str] = """\
port      = "/dev/ttyACM0"
stroke_mm = 60                         # from end switch to end switch
zero_mm   = 30                         # here the pusher touches the specimen at rest
joints    = { bend = { lever_mm = 100 } }        # angle is displacement over lever
calibration = { slope_n_per_count = 4.676e-6, offset_counts = 21400, residual_n = 0.004, date = "2026-03-02" }   # yours
limits = { travel_m = [-0.027, 0.027], speed_m_s = 0.005, force_n = 7, angle_deg = [-15, 15], speed_deg_s = 2 }"""

    port: Port
    rate_hz: float = Field(default=80.0, ge=1.0, le=80.0)
    stroke_mm: PositiveFloat = 60.0
    zero_mm: float = 30.0
    home_on_open: bool = False
    joints: dict[str, Lever] | None = Field(default=None, min_length=1, max_length=1)
    calibration: Calibration | None = None
    watchdog_ms: int = Field(default=100, ge=20, le=5_000)
    command_rate_hz: float = Field(default=20.0, ge=2.0, le=40.0)
    boot_wait_s: float = Field(default=3.0, ge=0.0, le=10.0)

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        if not 0.0 <= self.zero_mm <= self.stroke_mm:
            raise ValueError(
                f"zero_mm inside the stroke, 0 ... {self.stroke_mm:g} mm; it is {self.zero_mm:g}"
            )
        travel, whole = self.limits.travel_m, self.whole_travel_m
        if travel is not None and not _inside(travel, whole):
            raise ValueError(
                f"limits.travel_m inside the stroke, which about zero_mm = {self.zero_mm:g} is "
                f"[{whole[0]:g}, {whole[1]:g}] m; it is [{travel[0]:g}, {travel[1]:g}]"
            )
        if self.limits.force_n is not None:
            if self.calibration is None:
                raise ValueError("a calibration besides limits.force_n: without one there are no newtons")
            if self.calibration.line.most_counts(self.limits.force_n) == 0:
                raise ValueError(
                    f"limits.force_n above the offset of the load cell; it is {self.limits.force_n:g}: "
                    "balance the cell, or raise the limit"
                )
        self._check_joint()
        return self

    def _check_joint(self) -> None:
        """See that what a gait may ask of the joint is within travel and speed: plans know angles alone."""
        low, high = self.travel_m
        for lever_m in self.levers_m.values():
            if self.limits.angle_deg is not None:
                least_deg, most_deg = self.limits.angle_deg
                least_m, most_m = lever_m * math.radians(least_deg), lever_m * math.radians(most_deg)
                if not _inside((least_m, most_m), (low, high)):
                    raise ValueError(
                        f"limits.angle_deg that asks for no more travel than [{low:g}, {high:g}] m; on this lever "
                        f"[{least_deg:g}, {most_deg:g}] deg are [{least_m:.4g}, {most_m:.4g}] m"
                    )
            if self.limits.speed_deg_s is not None:
                asked_mm_s = 1e3 * lever_m * math.radians(self.limits.speed_deg_s)
                if asked_mm_s > 1e3 * self.fastest_m_s * (1 + _NM):
                    raise ValueError(
                        f"limits.speed_deg_s that asks for no more than {1e3 * self.fastest_m_s:g} mm/s; on this "
                        f"lever {self.limits.speed_deg_s:g} deg/s are {asked_mm_s:.4g} mm/s"
                    )

    @property
    def fastest_m_s(self) -> float:
        """The greatest speed that may be asked for, m/s."""
        return min(1e-3 * FASTEST_MM_S, self.limits.speed_m_s or math.inf)

    @property
    def whole_travel_m(self) -> tuple[float, float]:
        """From end switch to end switch, as displacement, m."""
        return -1e-3 * self.zero_mm, 1e-3 * (self.stroke_mm - self.zero_mm)

    @property
    def travel_m(self) -> tuple[float, float]:
        """Displacements that may be asked for, m."""
        return self.limits.travel_m or self.whole_travel_m

    @property
    def most_counts(self) -> int:
        """Magnitude of raw counts beyond which the board stops: of the force limit, or the whole range without one."""
        if self.limits.force_n is None or self.calibration is None:
            return FULL_SCALE_COUNTS
        return self.calibration.line.most_counts(self.limits.force_n)

    @property
    def levers_m(self) -> dict[str, float]:
        """Lever of each joint, m; empty where no joint is named."""
        return {joint: 1e-3 * table.lever_mm for joint, table in (self.joints or {}).items()}


def _inside(inner: tuple[float, float], outer: tuple[float, float]) -> bool:
    return outer[0] - _NM <= inner[0] and inner[1] <= outer[1] + _NM
