"""Keys of the stage in the experiment file, and its load cell: a straight line through at least five masses."""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from labrun.devices import DeviceSettings, FloatArray, Port
from labrun.toml import Keys

FULL_SCALE_COUNTS = 0x7FFFFF
"""Greatest value of an HX711; its least is one beyond on the other side. At either it is clipped."""
LEAST_COUNTS = -0x800000
MASSES = 5
"""Different masses that a calibration needs at least."""
_STANDARD_GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, slots=True)
class Line:
    """``force = slope_n_per_count * (counts - offset_counts)``.

    Attributes
    ----------
    slope_n_per_count
        Negative where the cell is wired or mounted the other way round.
    offset_counts
        What it reads without load.
    residual_n
        Standard deviation of the calibration's points about the line, N; None where nobody told.
    """

    slope_n_per_count: float
    offset_counts: float
    residual_n: float | None = None

    def force_n(self, counts: ArrayLike) -> FloatArray:
        """Return the force of these counts, N."""
        return np.asarray(self.slope_n_per_count * (np.asarray(counts, dtype=float) - self.offset_counts))

    def counts(self, force_n: ArrayLike) -> FloatArray:
        """Return the counts of a force in N, not rounded, not clipped."""
        return np.asarray(np.asarray(force_n, dtype=float) / self.slope_n_per_count + self.offset_counts)

    def most_counts(self, force_n: float) -> int:
        """Return the greatest magnitude of counts that is no more than a force (N) in either sense; 0 if there is none.

        The firmware compares the magnitude of raw counts, which knows no offset: this bound is `force_n` on the side of
        the offset, and ``2 |offset|`` counts less on the other. It stays below full scale: a clipped cell does not tell
        how great the force is, so that a limit beyond its range stops where the range ends.
        """
        most = force_n / abs(self.slope_n_per_count) - abs(self.offset_counts)
        return max(0, min(int(most), FULL_SCALE_COUNTS - 1))


def least_squares(
    masses_kg: Sequence[float], counts: Sequence[float], gravity_m_s2: float = _STANDARD_GRAVITY_M_S2
) -> Line:
    """Fit the line to readings under known masses; put them on and take them off again, and give both readings.

    The masses are known far better than the readings, so the readings are fitted over the weights, and the line is
    turned round.

    Raises
    ------
    ValueError
        Fewer than five different masses, lists of different length, numbers that are none, or readings that do not
        depend on the masses.
    """
    if len(masses_kg) != len(counts):
        raise ValueError(f"{len(masses_kg)} masses and {len(counts)} readings do not belong together")
    if len(set(masses_kg)) < MASSES:
        raise ValueError(f"{len(set(masses_kg))} different masses; a calibration needs {MASSES} or more")
    weight_n = gravity_m_s2 * np.asarray(masses_kg, dtype=float)
    read = np.asarray(counts, dtype=float)
    if not (np.isfinite(weight_n).all() and np.isfinite(read).all()):
        raise ValueError("masses and counts must be numbers")
    clipped = (read >= FULL_SCALE_COUNTS) | (read <= LEAST_COUNTS)
    if clipped.any():
        mass_kg = masses_kg[int(np.argmax(clipped))]
        raise ValueError(f"the reading under {mass_kg:g} kg is at the end of the amplifier's range")
    design = np.column_stack([np.ones(len(weight_n)), weight_n])
    (offset, per_n), *_ = np.linalg.lstsq(design, read, rcond=None)
    scatter = float(np.sqrt(np.sum((read - design @ (offset, per_n)) ** 2) / (len(read) - 2)))
    # Below three standard errors a slope is noise: the cell does not see the masses.
    if abs(per_n) <= 3.0 * scatter / float(np.sqrt(np.sum((weight_n - weight_n.mean()) ** 2))):
        raise ValueError("the readings do not depend on the masses: is the cell loaded and wired?")
    return Line(1.0 / float(per_n), float(offset), scatter / abs(float(per_n)))


class Calibration(BaseModel):
    """The table `calibration`: either the line itself, or the masses and the readings it is to be found from.

    .. code-block:: toml

        calibration = { slope_n_per_count = 4.676e-6, offset_counts = 21400, residual_n = 0.004, date = "2026-03-02" }

        [rig.devices.stage.calibration]
        masses_kg = [0, 0.1, 0.2, 0.4, 0.7, 0.7, 0.4, 0.2, 0.1, 0]
        counts    = [21410, 231190, 440870, 860300, 1489400, 1489630, 860560, 441020, 231260, 21380]
        date      = "2026-03-02"

    Attributes
    ----------
    slope_n_per_count, offset_counts, residual_n
        See `Line`.
    masses_kg, counts
        At least five different masses and the counts under each, on the way up and on the way down.
    gravity_m_s2
        Where the masses were weighed.
    date
        When; stored with every run.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    slope_n_per_count: float | None = None
    offset_counts: float = Field(default=0.0, gt=LEAST_COUNTS, lt=FULL_SCALE_COUNTS)
    residual_n: float | None = Field(default=None, ge=0.0)
    masses_kg: tuple[float, ...] = ()
    counts: tuple[float, ...] = ()
    gravity_m_s2: float = Field(default=_STANDARD_GRAVITY_M_S2, gt=9.7, lt=9.9)
    date: datetime.date | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        listed = bool(self.masses_kg or self.counts)
        if listed == (self.slope_n_per_count is not None):
            raise ValueError("expected either slope_n_per_count and offset_counts, or masses_kg and counts")
        if listed:
            try:
                least_squares(self.masses_kg, self.counts, self.gravity_m_s2)
            except ValueError as error:
                raise ValueError(f"masses_kg and counts make no line: {error}") from error
        elif self.slope_n_per_count == 0.0:
            raise ValueError("slope_n_per_count is 0: such a cell measures nothing")
        return self

    @property
    def line(self) -> Line:
        """The line from counts to newtons."""
        if self.slope_n_per_count is not None:
            return Line(self.slope_n_per_count, self.offset_counts, self.residual_n)
        return least_squares(self.masses_kg, self.counts, self.gravity_m_s2)


FASTEST_MM_S = 10.0
"""Of the firmware: beyond it the steps come too fast for what is checked at each of them."""
_NM = 1e-9
"""Slack when lengths in mm and m are compared."""


class Lever(Keys):
    """A joint that the stage bends: the equivalent angle is the displacement over this lever."""

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
            raise ValueError(f"zero_mm = {self.zero_mm:g} is outside the stroke, 0 ... {self.stroke_mm:g} mm")
        travel, whole = self.limits.travel_m, self.whole_travel_m
        if travel is not None and not _inside(travel, whole):
            raise ValueError(
                f"limits.travel_m = [{travel[0]:g}, {travel[1]:g}] leaves the stroke, which about "
                f"zero_mm = {self.zero_mm:g} is [{whole[0]:g}, {whole[1]:g}] m"
            )
        if self.limits.force_n is not None:
            if self.calibration is None:
                raise ValueError(
                    "limits.force_n needs a calibration: without one the cell gives counts, not newtons"
                )
            if self.calibration.line.most_counts(self.limits.force_n) == 0:
                raise ValueError(
                    f"limits.force_n = {self.limits.force_n:g} is below the offset of the load cell; "
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
                        f"limits.angle_deg = [{least_deg:g}, {most_deg:g}] is [{least_m:.4g}, {most_m:.4g}] m of "
                        f"travel on this lever, and the stage has [{low:g}, {high:g}] m; lower the limit"
                    )
            if self.limits.speed_deg_s is not None:
                asked_mm_s = 1e3 * lever_m * math.radians(self.limits.speed_deg_s)
                if asked_mm_s > 1e3 * self.fastest_m_s * (1 + _NM):
                    raise ValueError(
                        f"limits.speed_deg_s = {self.limits.speed_deg_s:g} is {asked_mm_s:.4g} mm/s on this lever, "
                        f"and the stage reaches {1e3 * self.fastest_m_s:g} mm/s; lower the limit"
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
