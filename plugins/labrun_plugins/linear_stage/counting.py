"""The board's two counters: which samples are new, how many are missing, and when each was taken."""

from dataclasses import dataclass

_WORD = 2**32
_HALF = 2**31
_RESTART_SAMPLES = 8
"""So many samples in a row that count up from behind the last one are no stragglers: the count began anew."""


def ahead(value: int, reference: int) -> int:
    """Return how far a 32-bit counter is ahead of a reference, negative behind it."""
    return (value - reference + _HALF) % _WORD - _HALF


@dataclass
class SampleCounter:
    """Takes the numbers of samples as they come; a sample that came twice or too late is not taken again.

    Attributes
    ----------
    repeated
        Samples that were not taken: duplicates and stragglers. A straggler was counted as lost before.
    restarted
        Whether the numbers began anew.
    """

    repeated: int = 0
    restarted: bool = False
    _last: int | None = None
    _behind: int = 0
    _behind_at: int = 0

    def take(self, n: int) -> int | None:
        """Return how many samples are missing before this one; None if it is not to be taken."""
        if self._last is None:
            self._last = n
            return 0
        step = ahead(n, self._last)
        if step > 0:
            self._last, self._behind = n, 0
            return step - 1
        self.repeated += 1
        self._behind = self._behind + 1 if self._behind and ahead(n, self._behind_at) == 1 else 1
        self._behind_at = n
        self.restarted = self.restarted or self._behind >= _RESTART_SAMPLES
        return None


@dataclass
class DeviceClock:
    """The board's microseconds without their wrap every 71.6 minutes."""

    _micros: int | None = None
    _whole_us: int = 0

    def time_s(self, micros: int) -> float:
        """Return the time of a sample, s on the board's clock."""
        self._whole_us = micros if self._micros is None else self._whole_us + ahead(micros, self._micros)
        self._micros = micros
        return 1e-6 * self._whole_us
