"""Force integrated over the recording."""

from collections.abc import Mapping
from typing import Any

import numpy as np


class Impulse:
    """Impulse of a force channel over the recording window, N s."""

    def __init__(self, channel: str | None, settings: Mapping[str, Any]) -> None:
        if channel is None:
            raise ValueError("impulse needs a channel")
        self._channel = channel

    def unit(self, channel_unit: str) -> str:
        return f"{channel_unit} s"

    def __call__(self, signals: Any) -> float:
        signal = signals.signal(self._channel)
        return float(np.trapezoid(signal.values, signal.time_s))
