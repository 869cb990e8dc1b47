"""What a signal was some steps ago, across blocks."""

from typing import Any

import numpy as np

from labrun.devices import FloatArray
from labrun_plugins.simulated.scenes.memory import packed, unpacked


class DelayLine:
    """Remembers the last `length` values of a signal; before the first one it was zero."""

    def __init__(self, length: int) -> None:
        self._past = np.zeros(length)

    def after(self, values: FloatArray, *delays: int) -> tuple[FloatArray, ...]:
        """Take the next values, and return what the signal was `delays` steps before each of them."""
        line = np.concatenate([self._past, values])
        end = len(line)
        count = len(values)
        self._past = line[end - len(self._past) :].copy()
        return tuple(line[end - count - delay : end - delay] for delay in delays)

    def snapshot(self) -> dict[str, Any]:
        """Return the memory as JSON-ready values."""
        return packed(self._past)

    def restore(self, stored: dict[str, Any]) -> None:
        """Take back what `snapshot` gave."""
        self._past = unpacked(stored)
