"""Set-points of a trajectory at a steady rate, from a thread of their own."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.devices.clock import Clock
from labrun.devices.trajectory import Trajectory

_KEPT = 200_000
"""Latenesses remembered: 33 minutes at 100 Hz bound the memory of a long trial."""
_DOZE_S = 0.05


@dataclass(frozen=True, slots=True)
class Pacing:
    """How evenly commands went out.

    Attributes
    ----------
    rate_hz
        Asked for.
    sent, missed
        Set-points sent, and those skipped because their successor was due already.
    late_median_s, late_p99_s, late_worst_s
        From when a set-point was due to when its sending began.
    """

    rate_hz: float
    sent: int = 0
    missed: int = 0
    late_median_s: float = 0.0
    late_p99_s: float = 0.0
    late_worst_s: float = 0.0


class CommandStream:
    """Sends set-points of one trajectory at a time; holds the last one.

    Parameters
    ----------
    send
        Puts one set-point, shape (joints,), on the wire. Called from the stream's own thread only; what it raises ends
        the stream, and is raised again by `check`.
    idle
        Called every `idle_every_s` while there is nothing to send, to feed the device's watchdog.
    """

    def __init__(
        self,
        clock: Clock,
        rate_hz: float,
        send: Callable[[FloatArray], None],
        *,
        idle: Callable[[], None] | None = None,
        idle_every_s: float = 0.03,
    ) -> None:
        self._clock = clock
        self._rate_hz = rate_hz
        self._send = send
        self._idle = idle
        self._idle_every_s = idle_every_s
        self._lock = threading.Lock()
        self._motion: tuple[Trajectory, float] | None = None
        self._number = 0
        self._changed = threading.Event()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None
        self._last: FloatArray | None = None
        self._late: deque[float] = deque(maxlen=_KEPT)
        self._sent = 0
        self._missed = 0

    @property
    def running(self) -> bool:
        """Tell whether the thread is alive, and not about to end once its last set-point is through."""
        return self._thread is not None and self._thread.is_alive() and not self._ending.is_set()

    @property
    def timing(self) -> Pacing:
        """How evenly set-points have gone out since the last `restart_timing`."""
        with self._lock:
            late, sent, missed = np.array(self._late), self._sent, self._missed
        if len(late) == 0:
            return Pacing(self._rate_hz, sent, missed)
        median_s, p99_s = np.percentile(late, (50, 99))
        return Pacing(self._rate_hz, sent, missed, float(median_s), float(p99_s), float(late.max()))

    def restart_timing(self) -> None:
        """Forget how evenly set-points have gone out so far."""
        with self._lock:
            self._late.clear()
            self._sent = self._missed = 0

    def start(self) -> None:
        """Begin the thread, with nothing to send; forgets an earlier failure."""
        if self.running:
            return
        self._failure = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(self._ending,), daemon=True, name="commands")
        self._thread.start()

    def follow(self, trajectory: Trajectory, start_s: float) -> None:
        """Send this motion from the clock's `start_s` on, in place of any other; then hold its last point."""
        self.start()
        with self._lock:
            self._motion = (trajectory, start_s)
            self._number += 1
        self._changed.set()

    def halt(self) -> None:
        """Stop sending at once, from any thread; never raises. `idle` continues."""
        # No lock: a set-point being sent at this moment may hold it, and a stop cannot wait for that.
        self._motion = None
        self._changed.set()

    def end(self, patience_s: float = 1.0) -> None:
        """End the thread; never raises."""
        self.halt()
        self._ending.set()
        self._changed.set()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(patience_s)

    def check(self) -> None:
        """Raise what `send` or `idle` raised."""
        if self._failure is not None:
            raise self._failure

    def set_point(self) -> FloatArray | None:
        """Return the angles sent last, shape (joints,); None before any."""
        return self._last

    def _run(self, ending: threading.Event) -> None:
        try:
            while not ending.is_set():
                with self._lock:  # a motion and its number belong together
                    motion, number = self._motion, self._number
                if motion is None:
                    self._rest()
                else:
                    self._drive(*motion, number)
        except Exception as failure:  # told by `check`, in the runner's thread
            if not ending.is_set():
                self._failure = failure

    def _rest(self) -> None:
        """Wait for a motion, feeding the watchdog."""
        if self._idle is not None:
            self._idle()
        self._changed.wait(self._idle_every_s if self._idle is not None else _DOZE_S)
        self._changed.clear()

    def _drive(self, trajectory: Trajectory, start_s: float, number: int) -> None:
        """Send one motion to its end, unless it is halted or superseded; then hold."""
        period_s = 1.0 / self._rate_hz
        last = int(np.ceil(trajectory.duration_s * self._rate_hz - 1e-9))
        step = 0
        idle_due_s = self._clock.now()
        while step <= last:
            due_s = start_s + step * period_s
            while (left_s := due_s - self._clock.now()) > 0:
                if self._idle is not None and self._clock.now() >= idle_due_s and left_s > self._idle_every_s:
                    self._idle()
                    idle_due_s = self._clock.now() + self._idle_every_s
                self._changed.wait(min(left_s, self._idle_every_s))
                if self._superseded(number):
                    return
            if self._superseded(number):
                return
            skip = self._overdue(due_s, last - step)
            angles = trajectory.at(min((step + skip) * period_s, trajectory.duration_s))[0]
            # A busy computer may have paused this thread just now: a set-point whose successor is due would leave for
            # nothing, and the next one right behind it would look like a jump.
            while (more := self._overdue(due_s, last - step)) > skip:
                skip = more
                angles = trajectory.at(min((step + skip) * period_s, trajectory.duration_s))[0]
            late_s = self._clock.now() - due_s - skip * period_s
            self._send(angles)
            self._last = angles
            with self._lock:
                self._late.append(late_s)
                self._sent += 1
                self._missed += skip
            step += skip + 1
        with self._lock:
            if self._number == number:
                self._motion = None

    def _overdue(self, due_s: float, most: int) -> int:
        """Return how many set-points, from the one due at `due_s` on, have a successor that is due; at most `most`."""
        return min(int((self._clock.now() - due_s) * self._rate_hz), most)

    def _superseded(self, number: int) -> bool:
        self._changed.clear()
        return self._motion is None or self._number != number or self._ending.is_set()
