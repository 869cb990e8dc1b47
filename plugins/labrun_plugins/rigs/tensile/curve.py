"""What one tensile test says: slope, toe, yield stress, fracture; after ASTM D882-12, with toe compensation."""

from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import FitError

_BACKWARDS = 1e-4
"""Strain that a strip may seem to lose on its way out: steps and play of a stage, not a way back."""
_STUCK = 5
"""So many equal readings at the very top are a load cell at the end of its range: its last digit never rests."""
_FALLS = 0.5
"""A fall of force by this share of its greatest, from one moment to the next, is a fracture."""
_FEWEST = 20


@dataclass(frozen=True, slots=True)
class TensileCurve:
    """One test.

    Attributes
    ----------
    young_pa
        Slope of the steepest straight part.
    toe_strain
        Where that straight line meets zero stress: the zero of strain (toe compensation, annex A1 of D882-12).
    yield_pa, yield_strain
        Where the curve departs from the line; strain without the toe. nan if it does not.
    greatest_n
        Force; at fracture, if `broke`.
    """

    young_pa: float
    toe_strain: float
    yield_pa: float
    yield_strain: float
    greatest_n: float
    broke: bool


def tensile_curve(
    force_n: FloatArray,
    displacement_m: FloatArray,
    *,
    area_m2: float,
    grips_m: float,
    window_strain: float = 0.003,
    departs_by_strain: float = 5e-4,
    label: str = "the test",
) -> TensileCurve:
    """Read modulus, toe, yield stress and fracture off force over displacement.

    The modulus is the greatest slope of a straight line through a stretch of `window_strain`. "Yield" is a proportional
    limit: where strain is `departs_by_strain` more than the line's.

    Raises
    ------
    FitError
        Strain that runs backwards, a load cell at the end of its range, or a test too short for a straight part.
    """
    strain, stress = displacement_m / grips_m, force_n / area_m2
    end = int(np.argmax(strain)) + 1
    lost = np.maximum.accumulate(strain[:end]) - strain[:end]
    if lost.max() > _BACKWARDS:
        place = int(np.argmax(lost))
        raise FitError(
            f"the strain of {label} runs backwards: it loses {100 * lost[place]:.2g} % "
            f"at {100 * strain[place]:.3g} %",
            hint="a strip that slips in its grips does that, or a grip that was driven back: mark the trial rejected",
        )
    strain, stress, force = strain[:end], stress[:end], force_n[:end]
    top = int(np.argmax(force))
    if np.count_nonzero(force == force[top]) >= _STUCK:
        raise FitError(
            f"the load cell is at the end of its range in {label}: {force[top]:.4g} N, and no more, "
            f"in {np.count_nonzero(force == force[top])} readings",
            hint="take a larger cell, or a narrower strip",
        )
    broke = bool(end - top > 2 and np.min(force[top : top + 10]) < (1.0 - _FALLS) * force[top])
    strain, stress = strain[: top + 1], stress[: top + 1]
    if len(strain) < _FEWEST or strain[-1] - strain[0] < 2.0 * window_strain:
        raise FitError(
            f"{label} has no straight part of {100 * window_strain:g} % strain: it ends at "
            f"{100 * (strain[-1] - strain[0]):.2g} % after {len(strain)} samples",
            hint="pull it further, or give the fit a smaller window_strain",
        )
    slope, at, level = _steepest(strain, stress, window_strain)
    if not slope > 0:
        raise FitError(f"force does not rise with strain in {label}", hint="are both signs right?")
    toe = at - level / slope
    beyond = (strain - toe) - stress / slope
    departs = np.flatnonzero((beyond >= departs_by_strain) & (strain > at))
    if not len(departs):
        return TensileCurve(slope, toe, np.nan, np.nan, float(force[top]), broke)
    first = int(departs[0])
    share = (departs_by_strain - beyond[first - 1]) / max(beyond[first] - beyond[first - 1], 1e-300)
    share = float(np.clip(share, 0.0, 1.0))
    yields = float(stress[first - 1] + share * (stress[first] - stress[first - 1]))
    yield_strain = float(strain[first - 1] + share * (strain[first] - strain[first - 1])) - toe
    return TensileCurve(slope, toe, yields, yield_strain, float(force[top]), broke)


def _steepest(strain: FloatArray, stress: FloatArray, window: float) -> tuple[float, float, float]:
    """Return slope, middle strain and mean stress of the steepest stretch of least squares."""
    ends = np.searchsorted(strain, strain + window, side="right")
    last = int(np.searchsorted(ends, len(strain)))
    starts = np.arange(max(last, 1))
    ends = np.minimum(ends[starts], len(strain))
    # sums of shifted values: squares of large numbers would cost digits
    x, y = strain - strain.mean(), stress - stress.mean()
    sums = [np.concatenate([[0.0], np.cumsum(one)]) for one in (x, y, x * x, x * y)]
    n = (ends - starts).astype(float)
    sx, sy, sxx, sxy = (one[ends] - one[starts] for one in sums)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    slopes[~np.isfinite(slopes) | (n < 3)] = -np.inf
    best = int(np.argmax(slopes))
    return (
        float(slopes[best]),
        float(strain.mean() + sx[best] / n[best]),
        float(stress.mean() + sy[best] / n[best]),
    )
