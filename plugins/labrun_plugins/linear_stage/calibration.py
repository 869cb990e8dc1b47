"""From the counts of a load cell to newtons: a straight line through at least five masses."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, model_validator

from labrun.devices import FloatArray

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
            raise ValueError("either slope_n_per_count and offset_counts, or masses_kg and counts")
        if listed:
            try:
                least_squares(self.masses_kg, self.counts, self.gravity_m_s2)
            except ValueError as error:
                raise ValueError(f"masses_kg and counts that make a line; {error}") from error
        elif self.slope_n_per_count == 0.0:
            raise ValueError("a slope_n_per_count other than 0: such a cell measures nothing")
        return self

    @property
    def line(self) -> Line:
        """The line from counts to newtons."""
        if self.slope_n_per_count is not None:
            return Line(self.slope_n_per_count, self.offset_counts, self.residual_n)
        return least_squares(self.masses_kg, self.counts, self.gravity_m_s2)
