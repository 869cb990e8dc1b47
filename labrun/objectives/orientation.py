"""Objectives of a loop that steers an orientation: how far off its Euler angles are, and how soon it recovers."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat, model_validator

from labrun.arrays import FloatArray
from labrun.errors import ExperimentError
from labrun.objectives.protocol import TrialSignals
from labrun.toml import Table, TableFaults, checked

Order = Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]
_PARTS = ("qw", "qx", "qy", "qz")


class EulerErrorSettings(Table):
    """Keys of `euler-error`.

    Attributes
    ----------
    loop
        Whose reference and feedback are quaternions.
    order
        ``"XYZ"``: R = Rx Ry Rz, turns about the axes of the body one after the other; small letters, about those of the
        room. It matters: in the order ZYX a two-axis spherical mechanism has no yaw at all.
    from_s, to_s
        The part of the recording that counts.
    """

    loop: str
    order: Order = "XYZ"
    from_s: NonNegativeFloat = 0.0
    to_s: PositiveFloat | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "EulerErrorSettings":
        with TableFaults() as faults:
            if self.to_s is not None and not self.from_s < self.to_s:
                faults.add("to_s", f"{self.to_s:g} s is not after from_s = {self.from_s:g} s")
        return self


class EulerError:
    """Mean absolute error of the three Euler angles of an orientation, deg (source, section 4.6)."""

    Settings: ClassVar[type[Table]] = EulerErrorSettings

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:  # noqa: ARG002
        self._keys = checked(self.Settings, settings)

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "deg"."""
        return "deg"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the mean over time and angles."""
        keys: Any = self._keys
        time_s, error = euler_errors(signals, keys.loop, keys.order)
        end_s = signals.end_s if keys.to_s is None else keys.to_s
        return float(np.mean(error[_part(time_s, keys.from_s, end_s)]))


class RecoveryTimeSettings(EulerErrorSettings):
    """Keys of `recovery-time`: those of `euler-error`, and what counts as recovered.

    Attributes
    ----------
    at_s
        When something changed.
    window_s
        Errors are averaged over so long.
    factor
        Recovered is what has come down to so many times the error between `from_s` and `to_s`, when all is steady.
    """

    at_s: NonNegativeFloat
    window_s: PositiveFloat = 2.0
    factor: PositiveFloat = 1.5


class RecoveryTime(EulerError):  # noqa: N818  (no exception: an error of angles)
    """How long after a change the error is down again, s; the rest of the recording, with a remark, if it never is.

    Counted from the change to the end of the first window, begun after the change, whose mean error is at most `factor`
    times the steady one.
    """

    Settings: ClassVar[type[Table]] = RecoveryTimeSettings

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "s"."""
        return "s"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the time."""
        keys: Any = self._keys
        recovered_s, _ = self._recovered(signals)
        return float((signals.end_s if recovered_s is None else recovered_s) - keys.at_s)

    def remark(self, signals: TrialSignals) -> str:
        """Return that it never was, if so."""
        recovered_s, bound = self._recovered(signals)
        if recovered_s is not None:
            return ""
        keys: Any = self._keys
        window_s = keys.window_s
        return (
            f"not recovered by the end of the trial: no {window_s:g} s had a mean error below {bound:.3g} deg"
        )

    def _recovered(self, signals: TrialSignals) -> tuple[float | None, float]:
        """Return when the error was down again, or None, and the error that counts as that, deg."""
        keys: Any = self._keys
        time_s, error = euler_errors(signals, keys.loop, keys.order)
        end_s = signals.end_s if keys.to_s is None else keys.to_s
        bound = keys.factor * float(np.mean(error[_part(time_s, keys.from_s, end_s)]))
        late = time_s >= keys.at_s
        mean = moving_mean(time_s[late], error[late], keys.window_s)
        down = np.flatnonzero((mean <= bound) & (time_s[late] >= keys.at_s + keys.window_s))
        return (float(time_s[late][down[0]]) if len(down) else None), bound


def euler_errors(signals: TrialSignals, loop: str, order: Order) -> tuple[FloatArray, FloatArray]:
    """Return the times of a loop's steps, and the mean magnitude of the three angles' errors there, deg."""
    from scipy.spatial.transform import Rotation  # a tenth of a second

    angles = []
    for quantity in ("reference", "feedback"):
        w, x, y, z = (signals.signal(f"loop.{loop}_{quantity}_{part}") for part in _PARTS)
        turned = Rotation.from_quat(np.column_stack([x.values, y.values, z.values, w.values]))
        angles.append(turned.as_euler(order, degrees=True))
    error = (angles[0] - angles[1] + 180.0) % 360.0 - 180.0
    return w.time_s, np.abs(error).mean(axis=1)


def moving_mean(time_s: FloatArray, values: FloatArray, window_s: float) -> FloatArray:
    """Return the mean of the values that each window up to a sample holds."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = np.arange(1, len(values) + 1)
    first = np.searchsorted(time_s, time_s - window_s)
    return np.asarray((total[last] - total[first]) / (last - first))


def _part(time_s: FloatArray, from_s: float, to_s: float) -> Any:
    chosen = (time_s >= from_s) & (time_s < to_s)
    if not chosen.any():
        raise ExperimentError(
            f"the loop has no step between {from_s:g} and {to_s:g} s",
            hint="check from_s, to_s and the duration of the trial",
        )
    return chosen
