"""Frames in the order of their numbers: gaps counted, repeats dropped, stragglers put back, a new count noticed."""

from dataclasses import dataclass

from labrun_plugins.optitrack.frame import Frame

_HOLD_S = 0.01
_HOLD_PERIODS = 1.5
_HOLD_MOST = 64
_WINDOW_S = 2.0
"""A number farther away than the frames of this time belongs to another count."""
_CLOSE = 5
_TOLD_S = 60.0
"""A longer time between two counts says that the clock is another one, too."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame, when it was exposed by the server's clock, when it arrived, and how many were lost just before it."""

    frame: Frame
    exposed_s: float
    host_s: float
    lost: int = 0


class FrameOrder:
    """Puts frames in order.

    A frame whose number is next is handed on at once. One that is ahead waits for those between for a few periods;
    then they are lost. A number that fits neither the count nor the clock begins a new count if the next frame goes on
    from it, and is dropped as garbage if not.

    Parameters
    ----------
    rate_hz
        Frames a second.

    Attributes
    ----------
    stale
        Frames dropped as repeats, or as too late.
    restarts
        How often the count began anew.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._hold_s = max(_HOLD_S, _HOLD_PERIODS / rate_hz)
        self._window = int(_WINDOW_S * rate_hz) + 1
        self.stale = 0
        self.restarts = 0
        self._last: Arrival | None = None
        self._held: dict[int, Arrival] = {}
        self._suspect: Arrival | None = None

    def put(self, frame: Frame, exposed_s: float, host_s: float) -> list[Arrival]:
        """Take a frame; return what can be handed on now, in order."""
        new = Arrival(frame, exposed_s, host_s)
        last = self._last
        if last is None:
            return [self._pass(new, 0)]
        ahead = _signed(frame.number - last.frame.number - 1)
        if 0 <= ahead <= self._window:
            self._suspect = None
            if frame.number in self._held:
                self.stale += 1
                return []
            self._held[frame.number] = new
            return self._in_turn() + self.flush(host_s)
        late_s = last.exposed_s - exposed_s  # of another clock where it is longer than numbers so near take
        if -self._window <= ahead < 0 and -0.5 / self._rate_hz <= late_s <= _WINDOW_S:
            self.stale += 1
            return self.flush(host_s)
        return self._begin_anew(new)

    def flush(self, now_s: float) -> list[Arrival]:
        """Return the frames that have waited long enough for those before them."""
        ready: list[Arrival] = []
        while self._held and (
            len(self._held) > _HOLD_MOST
            or now_s - min(arrival.host_s for arrival in self._held.values()) > self._hold_s
        ):
            assert self._last is not None  # noqa: S101  nothing is held before the first frame
            base = self._last.frame.number + 1
            ahead, number = min((_signed(number - base), number) for number in self._held)
            ready.append(self._pass(self._held.pop(number), ahead))
            ready += self._in_turn()
        return ready

    def _in_turn(self) -> list[Arrival]:
        ready: list[Arrival] = []
        while self._last is not None:
            following = self._held.pop(_signed(self._last.frame.number + 1), None)
            if following is None:
                break
            ready.append(self._pass(following, 0))
        return ready

    def _begin_anew(self, new: Arrival) -> list[Arrival]:
        first, self._suspect = self._suspect, new
        if first is None or not 0 < _signed(new.frame.number - first.frame.number) <= _CLOSE:
            return []
        self._suspect = None
        self.restarts += 1
        ready = self.flush(float("inf"))
        assert self._last is not None  # noqa: S101  there is no new count before the first
        # Numbers of two counts say nothing of what lies between; the clock does, if it went on.
        away = round((first.exposed_s - self._last.exposed_s) * self._rate_hz) - 1
        ready.append(self._pass(first, away if 0 <= away <= _TOLD_S * self._rate_hz else 0))
        self._held[new.frame.number] = new
        return ready + self._in_turn()

    def _pass(self, arrival: Arrival, lost: int) -> Arrival:
        # A frame that waited arrives for the host no earlier than the one it waited for.
        host_s = arrival.host_s if self._last is None else max(arrival.host_s, self._last.host_s)
        self._last = Arrival(arrival.frame, arrival.exposed_s, host_s, lost)
        return self._last


def _signed(number: int) -> int:
    """Return a number of 32 bit as a signed one: counts wrap."""
    return (number + 2**31) % 2**32 - 2**31
