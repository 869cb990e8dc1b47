"""What somebody with a watch sees of the free fish: how long a turn takes, how long a metre, whether it swims."""

import math

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import ExperimentError

ANSWERS = ("seconds_per_turn", "seconds_per_metre", "swims")
_REACTION_S = 0.1
"""Scatter of a thumb on a watch, at either end (chosen)."""
_SWIMS_M = 0.1
"""A fish that gets farther than that swims (chosen: a fifth of its length)."""


class Watch:
    """Keeps the course of a trial while the fins beat, and reads it as a person would.

    The first full turn, or metre, is left to the fish to get up to its speed; all that follow until the fins stop are
    timed together. One that makes no second is timed over its last, and one that does not get so far over what there
    is.
    """

    def __init__(self) -> None:
        self._blocks: list[FloatArray] = []

    def clear(self) -> None:
        """Begin anew: the fish was put back."""
        self._blocks = []

    def look(self, time_s: FloatArray, course: FloatArray, beating: FloatArray) -> None:
        """Take in place and heading, shape (n, 3), and whether fins beat, shape (n,)."""
        self._blocks.append(np.column_stack([time_s, course, beating]))

    def read(self, what: str, thumb: float) -> float | str:
        """Return what a person would type.

        Parameters
        ----------
        what
            One of `ANSWERS`.
        thumb
            How late the watch is stopped, in standard deviations.

        Raises
        ------
        ExperimentError
            Something else is asked for, or nothing was seen.
        """
        if what not in ANSWERS:
            raise ExperimentError(
                f"nobody can read {what!r} off this fish",
                hint=f"objectives.NAME.reads is one of {', '.join(ANSWERS)}",
            )
        seen = np.concatenate(self._blocks) if self._blocks else np.empty((0, 5))
        beats = np.flatnonzero(seen[:, 4])
        if len(beats) < 2:
            raise ExperimentError("no fin was seen to move", hint="look at the gait of this condition")
        seen = seen[beats[0] : beats[-1] + 1]
        if what == "swims":
            return "yes" if math.hypot(*(seen[-1, 1:3] - seen[0, 1:3])) > _SWIMS_M else "no"
        if what == "seconds_per_turn":
            way, begun, whole = (
                np.abs(seen[-1, 3] - seen[:, 3]),
                np.abs(seen[:, 3] - seen[0, 3]),
                2.0 * math.pi,
            )
        else:
            way = np.hypot(*(seen[-1, 1:3] - seen[:, 1:3]).T)
            begun, whole = np.hypot(*(seen[:, 1:3] - seen[0, 1:3]).T), 1.0
        up_to_speed = np.flatnonzero(begun >= whole)
        left = way[up_to_speed[0]] if len(up_to_speed) else 0.0
        far = np.flatnonzero(way >= max(1, math.floor(left / whole)) * whole)
        first = int(far[-1]) if len(far) else 0
        share = max(float(way[first]), 1e-9) / whole
        seconds = (float(seen[-1, 0] - seen[first, 0]) + math.sqrt(2.0) * _REACTION_S * thumb) / share
        return round(max(seconds, 0.1), 1)
