"""Where the joints are: one group read for all, stale answers told from fresh ones, silence noticed."""

import math
from collections import deque
from collections.abc import Mapping

from labrun.devices import Clock, DeviceError
from labrun_plugins.dynamixel.bus import TRIES, Bus
from labrun_plugins.dynamixel.codec import Status
from labrun_plugins.dynamixel.control_table import MOTION, PRESENT_POSITION, TICK, TICK_PERIOD_S
from labrun_plugins.dynamixel.report import shut_down

_WINDOW_S = 5.0
"""The two clocks drift apart by less than a millisecond in this time."""


class TickClock:
    """Follows the clock of a servo, which counts milliseconds and starts anew every 32.768 s."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._least: deque[tuple[float, float]] = deque()
        """Offsets that may still become the least one: each is greater than those before it."""

    def at(self, tick_ms: int, received_s: float) -> tuple[float, float]:
        """Return the servo's own time of an answer, and how much later than the quickest ones it arrived.

        Parameters
        ----------
        tick_ms
            What the answer says.
        received_s
            When it arrived, by the host's clock.

        Returns
        -------
        device_s, late_s : float
            Time by the servo's clock, which goes on where the count starts anew, and the answer's lateness compared
            with the least delayed one of the last seconds.
        """
        device_s = 1e-3 * tick_ms
        if self._last is not None:
            last_device_s, last_received_s = self._last
            expected_s = last_device_s + received_s - last_received_s
            device_s += TICK_PERIOD_S * math.floor((expected_s - device_s) / TICK_PERIOD_S + 0.5)
        offset_s = received_s - device_s
        while self._least and self._least[0][0] < received_s - _WINDOW_S:
            self._least.popleft()
        while self._least and self._least[-1][1] >= offset_s:
            self._least.pop()
        self._least.append((received_s, offset_s))
        self._last = (device_s, received_s)
        return device_s, offset_s - self._least[0][1]


_FRESH_S = 0.03
_SILENCE_S = 0.5
_STALE_S = 0.05


class Measurement:
    """What the servos of one bus said last; any thread.

    Parameters
    ----------
    bus
        Open.
    ids
        Of all servos, in the file's order.
    clock
        Of the run.

    Attributes
    ----------
    device_s
        Id -> time by the servo's own clock at its last answer.
    """

    def __init__(self, bus: Bus, ids: list[int], clock: Clock) -> None:
        self._bus = bus
        self._ids = ids
        self._clock = clock
        self._ticks = {identity: TickClock() for identity in ids}
        self._counts: dict[int, int] = {}
        self._heard_s = dict.fromkeys(ids, clock.now() - 1.0)
        self._missed_s: dict[int, float] = {}
        self.device_s: dict[int, float] = {}

    def counts(self) -> Mapping[int, int]:
        """Return where every servo stands, id -> count, asked for unless it was asked a moment ago.

        Raises
        ------
        DeviceError
            A servo does not answer, or has shut down.
        """
        begin_s = self._clock.now()
        if min(self._heard_s.values()) > begin_s - _FRESH_S:
            return dict(self._counts)
        tried = 0
        while tried < TRIES or self._clock.now() - begin_s < _SILENCE_S:  # on a busy computer one is in time
            self.take()
            tried += 1
            if min(self._heard_s.values()) >= begin_s:
                return dict(self._counts)
        self._blame([identity for identity in self._ids if self._heard_s[identity] < begin_s])
        raise DeviceError(
            self._bus.device,
            f"answers of its servos come more than {1e3 * _STALE_S:.0f} ms late, or at times not at all",
            hint="set the adapter's latency timer to 1 ms, and close programs that keep this computer busy",
        )

    def take(self) -> tuple[float, dict[int, Status]] | None:
        """Ask all servos once.

        Returns
        -------
        tuple or None
            When the answers were there, and the answers (block `MOTION`); None if not all came in time.

        Raises
        ------
        DeviceError
            One has shut down, or has been silent for too long, or the port is gone.
        """
        return self._note(self._bus.group_read(self._ids, MOTION))

    def hear(self) -> tuple[float, dict[int, Status]] | None:
        """Take the answers to a question that somebody else asks; otherwise as `take`."""
        return self._note(self._bus.hear(self._ids, MOTION))

    def last(self) -> Mapping[int, int]:
        """Return where every servo stood when it was heard last, id -> count; nothing is asked."""
        return dict(self._counts)

    def _note(self, answers: Mapping[int, Status]) -> tuple[float, dict[int, Status]] | None:
        now = self._clock.now()
        fresh: dict[int, Status] = {}
        for identity, status in answers.items():
            if status.alert:
                raise shut_down(self._bus, identity)
            self.device_s[identity], late_s = self._ticks[identity].at(TICK.within(MOTION, status.data), now)
            if late_s < _STALE_S:
                fresh[identity] = status
                self._counts[identity] = PRESENT_POSITION.within(MOTION, status.data)
                self._heard_s[identity] = now
                self._missed_s.pop(identity, None)
        if len(fresh) == len(self._ids):
            return now, fresh
        missed = {i: self._missed_s.setdefault(i, now) for i in self._ids if i not in fresh}
        self._blame([identity for identity, since_s in missed.items() if now - since_s > _SILENCE_S])
        return None

    def _blame(self, missing: list[int]) -> None:
        """Ask servos one by one, and raise what is wrong with the first that does not answer."""
        for identity in missing:
            self._bus.read_bytes(identity, MOTION)
