"""Feedbacks from one channel, from two, or from an orientation."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, PositiveFloat

from labrun.control.history import History
from labrun.control.protocol import Numbers
from labrun.devices import FloatArray
from labrun.errors import ExperimentError, SpecError
from labrun.toml import UNITS, Table, checked, suggest


class FeedbackSettings(Table):
    """Keys of a feedback from one channel, or from two.

    Attributes
    ----------
    channel
        ``device.channel``.
    scale, divide_by_m
        As of objectives: the channel is multiplied and divided by them.
    side_channel, side_scale
        The feedback is the magnitude of the vector that `channel` and this one make, each averaged first.
    unit
        Unit of the feedback where the channel's own is not that of the reference and the gains: ``"deg"`` for rad.
    """

    channel: str
    scale: float = 1.0
    divide_by_m: Annotated[float, Field(gt=0)] | None = None
    side_channel: str | None = None
    side_scale: float = 1.0
    unit: str | None = None


class ChannelFeedback(ABC):
    """The mean of a channel over its latest samples; a subclass says over how long.

    Parameters
    ----------
    units
        Unit of every channel, by ``device.channel``.

    Raises
    ------
    SpecError
        Keys that do not hold, or a `unit` of another kind than the channel's.
    """

    Settings: ClassVar[type[FeedbackSettings]] = FeedbackSettings
    _keys: FeedbackSettings
    channel_settings: ClassVar[tuple[str, ...]] = ("channel", "side_channel")

    def __init__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> None:
        self._keys = keys = checked(self.Settings, settings)
        sides = () if keys.side_channel is None else (keys.side_channel,)
        self.channels: tuple[str, ...] = (keys.channel, *sides)
        self.unit, factor = _unit_and_factor(keys, units.get(keys.channel, ""))
        self._factors = (factor * keys.scale, factor * keys.side_scale)

    def __call__(self, history: History, period_s: float | None) -> float:
        """Return the number now, in the unit of `unit`."""
        averages = [
            factor * mean_over(*history.recent(channel), self.memory_s(period_s))
            for channel, factor in zip(self.channels, self._factors, strict=False)
        ]
        return averages[0] if len(averages) == 1 else math.hypot(*averages)

    @property
    def factor(self) -> float:
        """What a sample of its (first) channel is multiplied by."""
        return self._factors[0]

    @abstractmethod
    def memory_s(self, period_s: float | None) -> float:
        """Return the length of the mean, s; 0 takes the newest sample."""


def _unit_and_factor(keys: FeedbackSettings, channel_unit: str) -> tuple[str, float]:
    """Return the unit of the feedback and the factor that converts a sample."""
    unit, factor = channel_unit, 1.0
    if keys.divide_by_m is not None:
        unit = unit.removesuffix(" m") if unit.endswith(" m") else f"{unit}/m"
        factor = 1.0 / keys.divide_by_m
    if keys.unit is None or keys.unit == unit:
        return unit, factor
    sizes = {item.label: item for item in UNITS.values()}
    wanted, given = sizes.get(keys.unit), sizes.get(unit)
    if wanted is None or given is None or wanted.dimension != given.dimension:
        alike = (
            []
            if given is None
            else [name for name, item in sizes.items() if item.dimension == given.dimension]
        )
        raise SpecError(
            f'unit = "{keys.unit}" is not a unit of {keys.channel}, which comes in {unit or "a unit of its own"}',
            hint=f"it can be {', '.join(alike)}" if alike else "leave unit out, and use scale",
        )
    return keys.unit, factor * given.si / wanted.si


def mean_over(time_s: FloatArray, values: FloatArray, window_s: float) -> float:
    """Return the mean over the last `window_s` up to the newest sample, by the trapezoidal rule over time.

    The window's start is interpolated, so that it covers exactly its length and lost samples weigh nothing. Where there
    are not samples for all of it, the mean of what there is.
    """
    end_s = time_s[-1]
    start_s = end_s - window_s
    first = int(np.searchsorted(time_s, start_s, side="right"))
    if first > 0:
        begin = values[first - 1]
        if time_s[first - 1] < start_s and first < len(time_s):
            gap_s = time_s[first] - time_s[first - 1]
            begin = begin + (values[first] - begin) * (start_s - time_s[first - 1]) / gap_s
    else:
        start_s, begin, first = time_s[0], values[0], 1
    span_s = end_s - start_s
    if first >= len(time_s) or span_s <= 0.0:
        return float(values[-1])
    inner_t, inner_v = time_s[first:], values[first:]
    total = 0.5 * (inner_t[0] - start_s) * (begin + inner_v[0])
    total += 0.5 * float(np.dot(np.diff(inner_t), inner_v[1:] + inner_v[:-1]))
    return float(total / span_s)


class LatestFeedback(ChannelFeedback):
    """The newest sample of a channel, as it is: for a sensor that is quiet, or filters itself."""

    def memory_s(self, period_s: float | None) -> float:  # noqa: ARG002
        """Return 0: nothing but the newest counts."""
        return 0.0


class MovingAverageSettings(FeedbackSettings):
    """Keys of `moving-average`: those of a channel, and the length of the window."""

    window_s: PositiveFloat


class MovingAverageFeedback(ChannelFeedback):
    """Mean over the last `window_s`, or over what exists at first; it lags by half of its window."""

    Settings: ClassVar[type[FeedbackSettings]] = MovingAverageSettings
    _keys: MovingAverageSettings

    def memory_s(self, period_s: float | None) -> float:  # noqa: ARG002
        """Return the window."""
        return self._keys.window_s


class CycleAverageSettings(FeedbackSettings):
    """Keys of `cycle-average`: those of a channel, and a cycle's length where the gait has none of its own."""

    period_s: PositiveFloat | None = None


class CycleAverageFeedback(ChannelFeedback):
    """Mean over the last gait cycle (source, section 5.1), which cancels periodic forces.

    Before one cycle is over, the mean of what there is. It lags by half a cycle.
    """

    Settings: ClassVar[type[FeedbackSettings]] = CycleAverageSettings
    _keys: CycleAverageSettings

    @staticmethod
    def needs_cycle(settings: Mapping[str, Any]) -> bool:
        """Tell that the gait must repeat, unless a period is given."""
        return "period_s" not in settings

    def memory_s(self, period_s: float | None) -> float:
        """Return one cycle. Raises SpecError: neither the gait nor the feedback has a cycle."""
        cycle_s = self._keys.period_s or period_s
        if cycle_s is None:
            raise SpecError(
                "cycle-average needs a gait with a cycle", hint="give it period_s, or use moving-average"
            )
        return cycle_s


COMPONENTS = ("qw", "qx", "qy", "qz")
_LEAST = 0.1
"""Length below which four numbers are no unit quaternion."""


class OrientationSettings(Table):
    """Keys of `orientation`: `body`, whose channels ``body_qw`` ... ``body_qz`` a tracker gives, as "cameras.horn"."""

    body: str


class OrientationFeedback:
    """The newest orientation of a body that a tracker follows: qw, qx, qy, qz, of length 1 and with qw >= 0.

    A quaternion and its negative are one orientation; within half a turn of the room's own axes qw >= 0 chooses one of
    them without a jump. What has no direction (a tracker that lost the body sends zeros) ends the run.

    Parameters
    ----------
    units
        Unit of every channel, by ``device.channel``.

    Raises
    ------
    SpecError
        Keys that do not hold.
    """

    Settings: ClassVar[type[Table]] = OrientationSettings
    several: ClassVar[bool] = True

    def __init__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> None:
        self._body = body = checked(OrientationSettings, settings).body
        self.channels: tuple[str, ...] = tuple(f"{body}_{name}" for name in COMPONENTS)
        self.unit = "1"
        missing = [channel for channel in self.channels if channel not in units]
        if missing:
            bodies = [unit.removesuffix("_qw") for unit in units if unit.endswith("_qw")]
            raise SpecError(
                f"nothing tells the orientation of {body}: it has no channel {missing[0]}",
                hint=f"body is the tracker and one of its bodies; {suggest(body, bodies, kind='tracked bodies')}",
            )

    @staticmethod
    def components(settings: Mapping[str, Any]) -> tuple[str, ...]:  # noqa: ARG004
        """Return the names of the numbers."""
        return COMPONENTS

    def memory_s(self, period_s: float | None) -> float:  # noqa: ARG002
        """Return 0: nothing but the newest counts."""
        return 0.0

    def __call__(self, history: History, period_s: float | None) -> Numbers:  # noqa: ARG002
        """Return the quaternion. Raises ExperimentError: it has no length."""
        w, x, y, z = [history.newest(channel)[1] for channel in self.channels]
        return unit_quaternion(w, x, y, z, body=self._body)


def unit_quaternion(w: float, x: float, y: float, z: float, *, body: str) -> Numbers:
    """Return the unit quaternion of a body's orientation, qw >= 0.

    Raises ExperimentError: no orientation: all four are next to nothing, or one is no number.
    """
    length = (w * w + x * x + y * y + z * z) ** 0.5
    if not length > _LEAST:
        raise ExperimentError(
            f"the tracker lost the body {body}: ({w:g}, {x:g}, {y:g}, {z:g}) is not an orientation",
            hint="let it be seen again, then labrun resume",
        )
    length = -length if w < 0.0 else length
    return w / length, x / length, y / length, z / length
