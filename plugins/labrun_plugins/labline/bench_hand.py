"""What an emulated board does to the simulated bench, without keeping its line waiting."""

import queue
import threading
from collections.abc import Callable


class BenchHand:
    """Carries out actions one after the other in a thread of its own: a bench that is busy may take long to answer."""

    def __init__(self) -> None:
        self._actions: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None

    def do(self, action: Callable[[], None]) -> None:
        """Have something done soon; raises what an earlier action raised."""
        if self._failure is not None:
            raise self._failure
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, daemon=True, name="bench")
            self._thread.start()
        self._actions.put(action)

    def close(self) -> None:
        """Do what is left, and end."""
        if self._thread is not None:
            self._actions.put(None)
            self._thread.join(1.0)
            self._thread = None

    def _work(self) -> None:
        while (action := self._actions.get()) is not None:
            try:
                action()
            except Exception as failure:
                self._failure = failure
                return
