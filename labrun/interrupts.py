"""Being asked to stop: Ctrl-C (SIGINT), a shutdown (SIGTERM), a closed terminal (SIGHUP); once or often, at any moment.

The first signal counts. Where nothing can be damaged it raises `StopSignal` at once. Where devices move or data are
written (`Interrupts.held`) it stops the actuators and is noted, and the run sees it at its next look. Every later
signal finds the end under way and changes nothing.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any

from labrun.errors import LabrunError

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGHUP: "SIGHUP (the terminal was closed)"}
_LOST_S = 10.0
"""A signal that comes so long after the one that was raised is raised as well: something swallowed the first."""
_PATIENCE_S = 2.0
"""How long after a signal a call under way may last until it is asked whether it hangs."""
_STOP_AGAIN_S = 1.0
"""Signals stop the actuators at most so often: a flood of them must not keep the run from its end."""


class StopSignal(KeyboardInterrupt):
    """A signal asked to stop. `number` is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__(signal_name(number))
        self.number = number


class Interrupted(LabrunError):  # noqa: N818  being asked to stop is no error
    """The run or command was asked to stop. The message says by what, and what was saved; the hint how to go on.

    Parameters
    ----------
    number
        The signal; the exit code is the one that shells give it.
    state
        What became of devices and data, to follow ``interrupted by Ctrl-C``.
    """

    def __init__(self, number: int, state: str, *, hint: str | None = None) -> None:
        super().__init__(f"interrupted by {signal_name(number)}{state}", hint=hint)
        self.number = number
        self.exit_code = exit_code(number)


def signal_name(number: int) -> str:
    """Return the usual name of a signal."""
    return _NAMES.get(signal.Signals(number), signal.Signals(number).name)


def exit_code(number: int) -> int:
    """Return the exit code of a process that a signal ended, as shells say it."""
    return 128 + number


def number_of(error: KeyboardInterrupt) -> int:
    """Return the signal number of an exception."""
    return error.number if isinstance(error, StopSignal) else int(signal.SIGINT)


class Interrupts:
    """What the handler of the three signals knows.

    Attributes
    ----------
    number
        The first signal that came; None as long as none has.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._held = False
        self._stop: Callable[[], object] | None = None
        self._hung: Callable[[], Exception | None] = lambda: None
        self._stopping = False
        self._stopped_s = -_STOP_AGAIN_S
        self._raised_s: float | None = None

    def check(self) -> None:
        """Raise Interrupted if a signal came."""
        if self.number is not None:
            raise Interrupted(self.number, ": actuators are stopped, data is kept")

    @contextmanager
    def held(
        self,
        stop: Callable[[], object] | None = None,
        hung: Callable[[], Exception | None] | None = None,
    ) -> Iterator[None]:
        """Note signals instead of raising them.

        Parameters
        ----------
        stop
            Called at once when one comes.
        hung
            Returns what to raise in the place of a call that does not return, None if no call hangs. It is asked some
            time after a signal, and when the watchdog sends its alarm (SIGALRM).
        """
        before = self._held, self._stop
        self._held, self._stop = True, self._stop if stop is None else stop
        try:
            with nullcontext() if hung is None else self._alarmed(hung):
                yield
        finally:
            self._held, self._stop = before

    @contextmanager
    def _alarmed(self, hung: Callable[[], Exception | None]) -> Iterator[None]:
        if installed() is not self:
            yield
            return
        self._hung, before = hung, signal.signal(signal.SIGALRM, self._alarm)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
            self._hung = lambda: None

    def _alarm(self, _number: int, _frame: FrameType | None) -> None:
        error = self._hung()
        if error is not None:
            self._stop_actuators()
            raise error

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Raise signals where they come, also one that was noted before. Raises StopSignal."""
        before = self._held, self._stop
        self._held, self._stop = False, None
        try:
            if self.number is not None and self._raised_s is None:
                self._raise(self.number)
            yield
        except Interrupted:
            raise
        except Exception as error:  # as the making of a class does, code may wrap whatever it meets
            wrapped = _signal_within(error)
            if wrapped is None:
                raise
            raise wrapped from None
        finally:
            self._held, self._stop = before

    def raise_again(self) -> None:
        """Send the signal once more, because the exception it was raised as got lost in compiled code."""
        self._raised_s = None
        os.kill(os.getpid(), signal.SIGINT if self.number is None else self.number)

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Take a signal: the handler of all three."""
        if self.number is None:
            self.number = number
        if self._held:
            self._stop_actuators()
            if signal.getsignal(signal.SIGALRM) == self._alarm:
                signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S, _PATIENCE_S)
        elif self._raised_s is None or time.monotonic() - self._raised_s > _LOST_S:
            self._raise(self.number)

    def _raise(self, number: int) -> None:
        self._raised_s = time.monotonic()
        raise StopSignal(number)

    def _stop_actuators(self) -> None:
        if self._stop is None or self._stopping or time.monotonic() - self._stopped_s < _STOP_AGAIN_S:
            return
        self._stopping = True
        try:
            self._stop()
        finally:
            self._stopping = False
            self._stopped_s = time.monotonic()


@contextmanager
def handled() -> Iterator[Interrupts]:
    """Handle the three signals; an outer block of this kind stays in charge.

    Outside of the main thread, where Python has no signal handlers, nothing is installed. A SIGHUP that is ignored
    (nohup) stays ignored.
    """
    outer = installed()
    if outer is not None:
        yield outer
        return
    interrupts = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield interrupts
        return
    before: dict[signal.Signals, Any] = {}
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            before[number] = signal.signal(number, interrupts.handle)
    try:
        yield interrupts
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) == interrupts.handle:
                signal.signal(number, handler)


def _signal_within(error: BaseException | None) -> StopSignal | None:
    """Return the signal that an exception was raised from; None if there was none."""
    while error is not None and not isinstance(error, StopSignal):
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return error


def installed() -> Interrupts | None:
    """Return what takes the signals of this process now; None if labrun does not, or in another thread."""
    if threading.current_thread() is not threading.main_thread():
        return None
    for number in SIGNALS:  # starting a process ignores one of them for a moment
        owner = getattr(signal.getsignal(number), "__self__", None)
        if isinstance(owner, Interrupts):
            return owner
    return None


def ignore_signals() -> None:
    """Ignore the three signals from now on: of a process that others tell when to end, or that is at its end."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
