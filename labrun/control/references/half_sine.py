"""A half-wave sine: arches, one after the other."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import PositiveFloat

from labrun.control.protocol import Condition
from labrun.toml import Table, checked


class HalfSineSettings(Table):
    """Keys of `half-sine`: from `low` up to `high` and back once in `period_s`."""

    low: float
    high: float
    period_s: PositiveFloat


class HalfSineReference:
    """``low + (high - low) |sin(pi t / period_s)|``, the reference of section 5.4 of the source.

    The source gives it as a figure only. Its amplitude (5.2), ``20 + |40 sin(2 pi 0.005 t)|`` deg, is the same wave:
    one arch takes 100 s.
    """

    Settings: ClassVar[type[Table]] = HalfSineSettings

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        keys = checked(HalfSineSettings, settings)
        self._low, self._rise = keys.low, keys.high - keys.low
        self._angular = math.pi / keys.period_s

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        return self._low + self._rise * abs(math.sin(self._angular * time_s))
