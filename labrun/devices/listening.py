"""A thread that hears a device, so that nothing is lost while the runner does something else."""

import threading
from collections.abc import Callable

from labrun.devices.buffering import SampleBuffer
from labrun.devices.samples import Samples


class Listener:
    """Calls `receive` again and again in a thread of its own until it is stopped or `receive` fails.

    Parameters
    ----------
    name
        Of the thread; the device's name.
    receive
        Takes what has arrived, waiting a few hundredths of a second for it at most. What it raises ends the thread,
        and is raised again by `check`.
    """

    def __init__(self, name: str, receive: Callable[[], None]) -> None:
        self._name = name
        self._receive = receive
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    @property
    def running(self) -> bool:
        """Whether the thread is alive."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Begin; forgets an earlier failure. Does nothing while it runs.

        A thread that was told to end and still hangs in `receive` is left to end by itself: another one takes over.
        """
        if self.running and not self._ending.is_set():
            return
        self._failure = None
        self._ending = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(self._ending,), daemon=True, name=f"listen to {self._name}"
        )
        self._thread.start()

    def stop(self, patience_s: float = 1.0) -> None:
        """End, and wait for the end this long at most; harmless if it does not run. Never raises."""
        self._ending.set()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(patience_s)

    def check(self) -> None:
        """Raise what `receive` raised."""
        if self._failure is not None:
            raise self._failure

    def deliver(self, buffer: SampleBuffer) -> Samples:
        """Return what has been heard; raise what `receive` raised only once all that came before it has been returned.

        Parameters
        ----------
        buffer
            Where `receive` puts its samples.
        """
        ended = not self.running
        block = buffer.take()
        if ended and not len(block):
            self.check()
        return block

    def _run(self, ending: threading.Event) -> None:
        try:
            while not ending.is_set():
                self._receive()
        except (
            Exception
        ) as failure:  # whatever a driver meets on the wire is told by `check`, in the runner's thread
            if not ending.is_set():
                self._failure = failure
