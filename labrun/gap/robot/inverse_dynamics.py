"""Motion and torque of a log prepared for inverse dynamics: differentiated without phase, low-passed alike, decimated.

The torque equation ``torque = Y(q, q', q'') parameters`` holds at every instant, and so it holds for both of its sides
passed through one linear filter. Without that filter the noise of the acceleration dilutes every inertia towards zero.
The cut of the filter is chosen where the estimates stop depending on it.

Gautier, Decision and Control 1997, 2284; Janot, Vandanjon, Gautier, IEEE Trans. Control Systems Technology 22 (2014)
132.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.gap import criteria
from labrun.gap.motion import smoothed

_ORDER = 4
_HIGHEST = 0.4
"""Highest cut, as a part of the sampling rate: a Butterworth filter needs room below half of it."""
_CUTS, _ABOVE_BAND, _MOTION_CUT = 8, 2.0, 4.0
"""Cuts that are compared; the lowest of them, in units of the motion's band; and the cut of the coordinates themselves,
in units of that of both sides."""
_BAND_POWER = 0.95
"""Part of the power of the joints' rates that lies in the motion's band."""
_SIGN_SPEED, _SIGN_NOISE = 0.01, 2.0
"""Speed over which the sign of a rate changes smoothly: a part of the peak, at least so many deviations of noise."""


Rows = TypeVar("Rows", FloatArray, NDArray[np.bool_])


@dataclass(frozen=True)
class Course:
    """One trial on a uniform time base.

    Attributes
    ----------
    label
        Of the condition it belongs to.
    time_s : (n,)
    measured, torque : (n, joints)
        Coordinates as measured and what the drives put on the joints, SI.
    """

    label: str
    time_s: FloatArray
    measured: FloatArray
    torque: FloatArray

    @property
    def step_s(self) -> float:
        """The sampling interval."""
        return float(self.time_s[1] - self.time_s[0])


@dataclass(frozen=True)
class Moved:
    """Coordinates, rates and accelerations of one trial, (n, joints) each."""

    q: FloatArray
    rate: FloatArray
    acceleration: FloatArray


def uniform(
    label: str, time_s: FloatArray, measured: FloatArray, torque: FloatArray, step_s: float
) -> Course:
    """Put a trial on a uniform time base of that step, by cubic splines; torques run linearly between samples."""
    from scipy.interpolate import make_interp_spline

    if np.allclose(np.diff(time_s), step_s, rtol=1e-3):
        return Course(label, time_s[0] + step_s * np.arange(len(time_s)), measured, torque)
    count = int((time_s[-1] - time_s[0]) / step_s) + 1
    even = time_s[0] + step_s * np.arange(count)
    at = np.minimum(even, time_s[-1])
    between = np.column_stack([np.interp(at, time_s, column) for column in torque.T])
    return Course(label, even, make_interp_spline(time_s, measured, k=3)(at), between)


def low_passed(values: FloatArray, step_s: float, cut_hz: float) -> FloatArray:
    """Return columns (n, ...) passed forward and backward through a Butterworth filter."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(_ORDER, min(2.0 * cut_hz * step_s, 0.98), output="sos")
    pad = min(len(values) - 1, round(2.0 / (cut_hz * step_s)))
    passed: FloatArray = sosfiltfilt(sections, values, axis=0, padlen=pad)
    return passed


def differentiated(course: Course, cut_hz: float) -> Moved:
    """Return coordinates low-passed without phase, and their derivatives by quintic splines."""
    from scipy.interpolate import make_interp_spline

    step_s = course.step_s
    q = low_passed(course.measured, step_s, cut_hz) if 2.0 * cut_hz * step_s < 0.98 else course.measured
    spline = make_interp_spline(course.time_s, q, k=5)
    return Moved(q, spline.derivative(1)(course.time_s), spline.derivative(2)(course.time_s))


def decimated(rows: Rows, course: Course, cut_hz: float) -> Rows:
    """Return every so many of the rows that a cut leaves independent, without the ends that the filter bends."""
    every, ends = _decimation(course, cut_hz)
    return rows[ends : len(rows) - ends : every]


def _decimation(course: Course, cut_hz: float) -> tuple[int, int]:
    every = max(1, int(0.8 / (2.0 * cut_hz * course.step_s)))
    ends = min(int(np.ceil(0.5 / (cut_hz * course.step_s))), len(course.time_s) // 8)
    return every, ends


def sign_speeds(courses: Sequence[Course], moved: Sequence[Moved]) -> FloatArray:
    """Return the speed of each joint over which the sign of its rate changes smoothly, (joints,)."""
    peaks = np.max([np.abs(each.rate).max(axis=0) for each in moved], axis=0)
    noise = _rate_noise(courses, moved)
    return np.asarray(np.maximum(np.maximum(_SIGN_SPEED * peaks, _SIGN_NOISE * noise), 1e-12))


def _rate_noise(courses: Sequence[Course], moved: Sequence[Moved]) -> FloatArray:
    """Return the standard deviation of the noise in the rates, from what the filter took out of the coordinates."""
    removed = np.concatenate([each.measured - moving.q for each, moving in zip(courses, moved, strict=True)])
    noise = np.sqrt(np.mean(np.square(removed), axis=0))
    step_s = courses[0].step_s
    # white noise of the coordinate in the band that was kept, differentiated
    kept = _spectral_cut(courses, moved)
    share = np.sqrt((2.0 * kept * step_s) ** 3 / 3.0)
    rates: FloatArray = noise * share * np.pi / step_s
    return rates


def _spectral_cut(courses: Sequence[Course], moved: Sequence[Moved]) -> float:
    """Return the frequency up to which the coordinates were kept, from the spectrum of what is left of them."""
    course, moving = courses[0], moved[0]
    frequency = np.fft.rfftfreq(len(course.time_s), course.step_s)
    before = np.abs(np.fft.rfft(course.measured - course.measured.mean(axis=0), axis=0)).sum(axis=1)
    gone = np.abs(np.fft.rfft(course.measured - moving.q, axis=0)).sum(axis=1)
    lost = np.flatnonzero(gone > 0.5 * before)
    return float(frequency[lost[0]]) if lost.size and lost[0] else 0.5 / course.step_s


def motion_band_hz(courses: Sequence[Course]) -> float:
    """Return the frequency below which most of the power of the joints' rates lies, noise smoothed out of them."""
    power: dict[float, float] = {}
    for course in courses:
        rates = smoothed(course.time_s, course.measured)[1]
        size = np.maximum(rates.std(axis=0), 1e-12)
        spectrum = np.square(np.abs(np.fft.rfft(rates / size, axis=0))).sum(axis=1)
        frequencies = np.fft.rfftfreq(len(rates), course.step_s)
        for frequency, amplitude in zip(frequencies.tolist(), spectrum.tolist(), strict=True):
            power[frequency] = power.get(frequency, 0.0) + amplitude
    ordered = sorted(power)
    total = np.cumsum([power[frequency] for frequency in ordered])
    index = int(np.searchsorted(total, _BAND_POWER * total[-1]))
    return max(ordered[index], 1.0 / float(courses[0].time_s[-1] - courses[0].time_s[0]))


def moves(rate: FloatArray, speed: float, length: int) -> NDArray[np.bool_]:
    """Tell where a joint moves: not in rests longer than `length` samples, nor that near to one.

    At rest dry friction takes any value up to its level, so that no equation holds there.
    """
    from scipy.ndimage import binary_dilation, binary_opening

    still = np.abs(rate) < speed
    rests = binary_opening(still, np.ones(max(length, 1), dtype=bool))
    return np.asarray(~binary_dilation(rests, np.ones(2 * length + 1, dtype=bool)))


@dataclass(frozen=True)
class Cut:
    """The low pass of both sides of the equation.

    Attributes
    ----------
    hz
    tried
        Cuts that were compared, Hz.
    scales : (cuts, joints)
        Inertial torque that the log shows at each cut, in units of what the file states; NaN where it shows none.
    stable
        Whether the estimates depend on the cut by less than their scatter, or by less than matters.
    """

    hz: float
    tried: FloatArray
    scales: FloatArray
    stable: bool

    @property
    def sentence(self) -> str:
        """Which cut it is, and why."""
        if len(self.tried) == 1:
            return f"torque and regressor are low-passed at {self.hz:.3g} Hz, the highest cut the sampling rate allows"
        last, higher = int(np.argmin(np.abs(self.tried - self.hz))), ""
        if last + 1 < len(self.tried):
            first = np.where(self.scales[0] > 0.0, self.scales[0], np.nan)  # a dead channel has no scale
            drop = self.scales[last + 1] / first
            if np.isfinite(drop).any():
                joint = int(np.nanargmax(np.abs(np.log(np.maximum(drop, 1e-3)))))
                higher = (
                    f"; at {self.tried[last + 1]:.3g} Hz an inertia reads {drop[joint]:.2f} times what it reads at "
                    f"{self.tried[0]:.3g} Hz"
                )
        held = (
            "the estimates depend on it no more below"
            if self.stable
            else "the estimates depend on it even there"
        )
        return f"torque and regressor are low-passed at {self.hz:.3g} Hz: {held}{higher}"


Columns = Callable[[Course, Moved], FloatArray]
"""(joints, n, columns): the inertial part of the stated torque first, then the torque that was logged last."""


def choose_cut(courses: Sequence[Course], columns: Columns, blocks: int) -> Cut:
    """Choose the highest cut at which the inertia that each joint shows is the same as at all lower ones.

    Parameters
    ----------
    columns
        What the torque of a joint is fitted with in one regression: its inertial part as stated, then what stands
        beside it, and last the logged torque itself.
    blocks
        Pieces of each trial, by which the scatter of the estimates is told.
    """
    step_s = courses[0].step_s
    highest = _HIGHEST / step_s
    lowest = min(_ABOVE_BAND * motion_band_hz(courses), highest)
    tried = np.geomspace(lowest, highest, _CUTS) if lowest < 0.9 * highest else np.array([highest])
    joints = courses[0].measured.shape[1]
    if len(tried) == 1:
        return Cut(float(tried[0]), tried, np.full((1, joints), np.nan), stable=True)
    estimates = np.array([_scales(courses, columns, cut, blocks) for cut in tried])
    first = estimates[0]
    stable_at = []
    for at_cut in estimates[1:]:
        agrees = True
        for joint in range(joints):
            values, deviation = _jackknife(at_cut[joint] - first[joint])
            size, spread = _jackknife(first[joint])
            if not np.isfinite(values) or not abs(size) > 2.0 * spread:
                continue
            agrees &= abs(values) <= max(
                criteria.STANDARD_ERRORS * deviation, 0.5 * criteria.MARGIN * abs(size)
            )
        stable_at.append(agrees)
    count = next((index for index, agrees in enumerate(stable_at) if not agrees), len(stable_at))
    scales = estimates.mean(axis=2)
    return Cut(float(tried[count]), tried, scales, stable=count > 0)


def _scales(courses: Sequence[Course], columns: Columns, cut_hz: float, blocks: int) -> FloatArray:
    """Return the coefficient of the inertial part, each block left out in turn, shape (joints, all blocks)."""
    joints = courses[0].measured.shape[1]
    grams: list[list[FloatArray]] = [[] for _ in range(joints)]
    for course in courses:
        of_joints = columns(course, differentiated(course, motion_cut_hz(cut_hz)))
        for joint, values in enumerate(of_joints):
            rows = decimated(low_passed(values, course.step_s, cut_hz), course, cut_hz)
            grams[joint] += [part.T @ part for part in np.array_split(rows, blocks)]
    result = []
    for squares in grams:
        stacked = np.array(squares)
        left_out = stacked.sum(axis=0) - stacked
        scale = np.sqrt(np.maximum(np.diagonal(left_out, axis1=1, axis2=2), 1e-300))
        normal = left_out / scale[:, :, None] / scale[:, None, :]
        if normal[0, 0, 0] < 0.5:
            result.append(np.full(len(squares), np.nan))
            continue
        right = normal[:, :-1, -1]
        solved = np.array(
            [
                np.linalg.lstsq(row[:-1, :-1], side, rcond=1e-10)[0][0]
                for row, side in zip(normal, right, strict=True)
            ]
        )
        result.append(solved * scale[:, -1] / scale[:, 0])
    return np.array(result)


def _jackknife(left_out: FloatArray) -> tuple[float, float]:
    """Return mean and standard error from estimates with one block left out each."""
    count = len(left_out)
    mean = float(left_out.mean())
    return mean, float(np.sqrt((count - 1) / count * np.sum(np.square(left_out - mean))))


def motion_cut_hz(cut_hz: float) -> float:
    """Return the cut of the coordinates before they are differentiated: well above that of both sides."""
    return _MOTION_CUT * cut_hz
