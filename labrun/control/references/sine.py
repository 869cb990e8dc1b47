"""A sine."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import PositiveFloat

from labrun.control.protocol import Condition
from labrun.toml import Table, checked


class SineSettings(Table):
    """Keys of `sine`: ``mean + amplitude sin(2 pi t / period_s + phase)``."""

    mean: float = 0.0
    amplitude: float
    period_s: PositiveFloat
    phase_deg: float = 0.0


class SineReference:
    """A sine around a mean."""

    Settings: ClassVar[type[Table]] = SineSettings

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        keys = checked(SineSettings, settings)
        self._mean, self._amplitude = keys.mean, keys.amplitude
        self._angular = 2.0 * math.pi / keys.period_s
        self._phase = math.radians(keys.phase_deg)

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        return self._mean + self._amplitude * math.sin(self._angular * time_s + self._phase)
