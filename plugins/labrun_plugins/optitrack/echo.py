"""The server's clock against the host's, by questions and answers."""

from collections import deque
from dataclasses import dataclass

_KEPT = 60
_NS = 1e9


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Server's time minus the host's, s, and the round trip it was measured over; it is off by half of that at most."""

    offset_s: float
    round_trip_s: float


class Echoes:
    """Keeps the last answers; the one with the shortest way tells most."""

    def __init__(self) -> None:
        self._answers: deque[ClockOffset] = deque(maxlen=_KEPT)

    def __len__(self) -> int:
        return len(self._answers)

    @staticmethod
    def ticks(now_s: float) -> int:
        """Return what is sent along with a question: the host's time in ns."""
        return int(now_s * _NS)

    def answered(self, own_ticks: int, server_ticks: int, clock_hz: int, now_s: float) -> None:
        """Take an answer; one that says it was asked in the future, or long ago, is none."""
        asked_s = own_ticks / _NS
        if not 0.0 <= now_s - asked_s <= 1.0:
            return
        offset_s = server_ticks / clock_hz - 0.5 * (asked_s + now_s)
        self._answers.append(ClockOffset(offset_s, now_s - asked_s))

    def best(self) -> ClockOffset | None:
        """Return the answer with the shortest round trip; None if there is none."""
        return min(self._answers, key=lambda answer: answer.round_trip_s, default=None)
