"""Whether joints that are measured followed their command."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray, Trajectory
from labrun.errors import DeviceError
from labrun.experiment import Follow
from labrun.runner.motion import TrialMotion
from labrun.runner.rig import Rig
from labrun.signals import LongSignals, Signal, Signals

_WINDOW = 4
"""The time beyond the limit is added up over so many times `for_s`: an oscillating command passes a limp joint twice
a cycle, so that it is never beyond the limit for long without a break."""
_LAGS = 5
"""Moments within `lag_s` at which the command is looked at."""


def measured_joints(rig: Rig) -> dict[str, tuple[str, str]]:
    """Return the joints whose own actuator measures them, joint -> (device, channel): ``tail`` by ``tail_angle``."""
    measured = {}
    for joint, device in rig.joints.items():
        sensor = rig.sensors.get(device)
        if sensor is not None and any(
            c.name == f"{joint}_angle" and c.unit == "rad" for c in sensor.channels
        ):
            measured[joint] = (device, f"{joint}_angle")
    return measured


def require_followed(
    rule: Follow,
    rig: Rig,
    recorded: Mapping[str, Signals | LongSignals],
    motion: TrialMotion,
    *,
    periodic: bool,
) -> None:
    """Compare the measured angles of a recording with the motion that was sent.

    Parameters
    ----------
    recorded
        What was measured, by device; time from the start of the motion.
    periodic
        Whether the motion goes on after its end as it began.

    Raises
    ------
    DeviceError
        A joint was farther from its command than `rule` allows, for longer than it allows.
    """
    for joint, (device, channel) in measured_joints(rig).items():
        if joint not in motion.trajectory.joints or device not in recorded:
            continue
        command = motion.trajectory.only((joint,))
        period_s = motion.period_s if periodic else None
        for piece in recorded[device].signal_pieces(channel):
            error_rad = _distance(piece, command, rule.lag_s, period_s)
            lost_s = _lost_from(piece.time_s, error_rad > np.radians(rule.within_deg), rule.for_s)
            if lost_s is None:
                continue
            worst_deg = float(np.degrees(error_rad[piece.time_s >= lost_s].max()))
            raise DeviceError(
                device,
                f"joint {joint} did not follow its command: from {lost_s:.2f} s of the recording on it was up to "
                f"{worst_deg:.3g} deg away from it; trial.follow allows {rule.within_deg:g} deg, and more for "
                f"{rule.for_s:g} s within {_WINDOW * rule.for_s:g} s",
                hint="look for a joint that is blocked, overloaded or without torque; a slower motion, or "
                "trial.follow.within_deg and trial.follow.for_s, if the lag is meant",
            )


def _distance(measured: Signal, command: Trajectory, lag_s: float, period_s: float | None) -> FloatArray:
    """Return how far each sample is from all that was commanded in the `lag_s` before it, rad; shape (n,)."""
    lowest, highest = np.full(len(measured.time_s), np.inf), np.full(len(measured.time_s), -np.inf)
    for delay_s in np.linspace(0.0, lag_s, _LAGS):
        time_s = measured.time_s - delay_s
        angle_rad = command.at(time_s if period_s is None else np.mod(time_s, period_s))[:, 0]
        lowest, highest = np.minimum(lowest, angle_rad), np.maximum(highest, angle_rad)
    return np.asarray(np.maximum(0.0, np.maximum(lowest - measured.values, measured.values - highest)))


def _lost_from(time_s: FloatArray, beyond: NDArray[np.bool_], for_s: float) -> float | None:
    """Return the start of the first window with samples `beyond` for longer than `for_s`, or None."""
    if len(time_s) < 2 or not beyond.any():
        return None
    steps_s = np.diff(time_s, prepend=time_s[0])
    usual_s = float(np.median(steps_s[1:]))
    total_s = np.cumsum(np.where(beyond, np.minimum(steps_s, 2.0 * usual_s), 0.0))
    before = np.searchsorted(time_s, time_s - _WINDOW * for_s, side="left")
    within_s = total_s - np.where(before > 0, total_s[np.maximum(before - 1, 0)], 0.0)
    late = within_s > for_s
    if not late.any():
        return None
    first = int(before[int(np.argmax(late))])
    return float(time_s[first + int(np.argmax(beyond[first:]))])
