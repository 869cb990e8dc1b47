"""Stopping everything that moves: first thing on any exit, whatever the reason."""

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from labrun.devices import Device
from labrun.errors import LabrunError
from labrun.runner.clock import RealClock
from labrun.runner.faults import Interrupted

PATIENCE_S = 2.0
"""How long the devices' stops may take before the others' results are reported without one that hangs."""
_BEAT_S = 0.05


def stop_all(devices: Mapping[str, Device], beat: Callable[[], object] = lambda: None) -> list[str]:
    """Stop every device at the same time; never raises.

    Each stop runs in a thread of its own: a device that hangs cannot keep the others moving, and a driver whose lock
    the interrupted main thread holds gets it as soon as that thread goes on.

    Parameters
    ----------
    devices
        By name.
    beat
        Called while waiting: a stop that hangs is no reason for the watchdog to kill the runner with its data.

    Returns
    -------
    list of str
        One sentence for every device that could not be stopped in time.
    """
    failures: dict[str, str] = {}

    def stop(name: str, device: Device) -> None:
        try:
            device.safe_stop()
        except BaseException as error:  # a driver must not raise here; if it does, the others still stop
            failures[name] = f"{name} could not be stopped: {type(error).__name__}: {error}"

    threads: dict[str, threading.Thread] = {}
    for name, device in devices.items():
        thread = threading.Thread(target=stop, args=(name, device), daemon=True, name=f"stop {name}")
        try:
            thread.start()
        except RuntimeError:  # no threads any more: the interpreter is going down
            stop(name, device)
            continue
        threads[name] = thread
    clock = RealClock()
    deadline_s = clock.now() + PATIENCE_S
    for name, thread in threads.items():
        while thread.is_alive() and (left_s := deadline_s - clock.now()) > 0:
            thread.join(min(_BEAT_S, left_s))
            with suppress(LabrunError):  # the watchdog is gone: the stop goes on without it
                beat()
        if thread.is_alive():
            failures[name] = f"{name} did not stop within {PATIENCE_S:g} s"
    return list(failures.values())


class StopRequest:
    """Whether a person or the system asked the run to end."""

    def __init__(self) -> None:
        self.reason: str | None = None

    def check(self) -> None:
        """Raise Interrupted if the run was asked to end."""
        if self.reason is not None:
            raise Interrupted(f"interrupted by {self.reason}: actuators are stopped, data is kept")


@contextmanager
def interruptible(stop: Callable[[], object]) -> Iterator[StopRequest]:
    """Turn Ctrl-C and SIGTERM into a stop at once and a request that the run sees at its next look at the bench.

    The handler only stops the actuators and notes the request, so that it can never cut a file being written; asking
    again stops again. Outside the main thread, where Python has no signal handlers, nothing is installed.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def handle(number: int, _frame: FrameType | None) -> None:
        request.reason = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        stop()

    previous: dict[signal.Signals, Any] = {}
    for wanted in (signal.SIGINT, signal.SIGTERM):
        previous[wanted] = signal.signal(wanted, handle)
    try:
        yield request
    finally:
        for wanted, handler in previous.items():
            signal.signal(wanted, handler)
