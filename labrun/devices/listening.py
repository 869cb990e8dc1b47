"""A thread that receives samples of a device, and its buffer."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike

from labrun.arrays import FloatArray
from labrun.devices.clock import Clock
from labrun.devices.protocols import Sensor, streaming
from labrun.devices.samples import Channel, Samples

_JUMP_S = 1.0
"""A device clock that differs by more from what it was was set or garbled: its offset is found anew."""


class SampleClock:
    """Tells when samples were made, by the run's clock: received no sooner than made, as in the stored times."""

    def __init__(self) -> None:
        self._behind_s = np.inf

    def made_s(self, device_time_s: FloatArray, host_time_s: FloatArray) -> FloatArray:
        """Return the times of a block, (n,) with n > 0."""
        least = float((host_time_s - device_time_s).min())
        if not abs(least - self._behind_s) < _JUMP_S or least < self._behind_s:
            self._behind_s = least
        return device_time_s + self._behind_s


_LOOK_EVERY_S = 0.02


class SampleBuffer:
    """Collects samples until someone takes them; any number of threads.

    Parameters
    ----------
    channels
        Number of values in a sample.
    """

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._lock = threading.Lock()
        self._blocks: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        self._lost = 0
        self._saturated = 0

    def put(
        self,
        device_time_s: ArrayLike,
        host_time_s: ArrayLike,
        values: ArrayLike,
        *,
        lost: int = 0,
        saturated: int = 0,
    ) -> None:
        """Add one sample (two numbers and a row) or a block (two vectors and a matrix of rows).

        Parameters
        ----------
        device_time_s, host_time_s : () or (n,)
            As of `Samples`.
        values : (channels,) or (n, channels)
            SI units.
        lost, saturated
            Samples that never arrived before these, and samples of these at the end of the range.

        Raises
        ------
        ValueError
            Shapes that do not belong together.
        """
        rows = np.array(values, dtype=float, ndmin=2)
        device_s = np.array(device_time_s, dtype=float, ndmin=1)
        host_s = np.array(host_time_s, dtype=float, ndmin=1)
        if rows.shape != (len(host_s), self._channels) or len(device_s) != len(host_s):
            raise ValueError(
                f"{len(device_s)} device times, {len(host_s)} host times and values of shape {rows.shape} "
                f"do not make samples of {self._channels} channels"
            )
        with self._lock:
            self._blocks.append((device_s, host_s, rows))
            self._lost += lost
            self._saturated += saturated

    def count_lost(self, lost: int) -> None:
        """Add to the samples that never arrived."""
        with self._lock:
            self._lost += lost

    def take(self) -> Samples:
        """Return all samples since the last time, as one block; does not wait."""
        with self._lock:
            blocks, self._blocks = self._blocks, []
            lost, self._lost = self._lost, 0
            saturated, self._saturated = self._saturated, 0
        if not blocks:
            nothing = np.empty(0)
            return Samples(nothing, nothing, np.empty((0, self._channels)), lost=lost, saturated=saturated)
        device_s, host_s, rows = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        return Samples(device_s, host_s, rows, lost=lost, saturated=saturated)

    def clear(self) -> None:
        """Forget everything."""
        self.take()


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
        """Tell whether the thread is alive."""
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
        """Return received samples; an error of `receive` is raised after all samples before it.

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
        # whatever a driver meets on the wire is told by `check`, in the runner's thread
        except Exception as failure:
            if not ending.is_set():
                self._failure = failure


class ListeningSensor:
    """Base of sensors whose samples a thread receives.

    A driver extends it with `open`, `start` (which ends with `_listen`), `stop` (which begins with `_hear_no_more`) and
    `close`.
    """

    def __init__(self, name: str, channels: tuple[Channel, ...], rate_hz: float, clock: Clock) -> None:
        self.name = name
        self.channels = channels
        self.rate_hz = rate_hz
        self.clock = clock
        self._buffer = SampleBuffer(len(channels))
        self._listener: Listener | None = None

    @property
    def streams(self) -> bool:
        """Tell whether it was started."""
        return self._listener is not None

    def read(self) -> Samples:
        """Return all samples since the last call; does not wait.

        Raises DeviceError: not started; or, once everything that came has been handed over, what ended the stream.
        """
        return streaming(self.name, self._listener).deliver(self._buffer)

    def safe_stop(self) -> None:
        """Do nothing: a sensor moves nothing, and its data are wanted to the end."""

    def _listen(self, receive: Callable[[], None]) -> None:
        """Start receiving; earlier bytes are dropped. `receive`: as of `Listener`."""
        self._buffer.clear()
        self._listener = Listener(self.name, receive)
        self._listener.start()

    def _check(self) -> None:
        """Raise the error that ended the stream, if any."""
        if self._listener is not None:
            self._listener.check()

    def _hear_no_more(self) -> bool:
        """End the thread; return whether it was running. Never raises."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.stop()
        return listener is not None


@contextmanager
def listened(sensor: Sensor, clock: Clock, duration_s: float, *, streams: bool) -> Iterator[None]:
    """Listen for a while before the body; whatever did not stream before is stopped after it.

    Parameters
    ----------
    streams
        Whether it streams already: what comes is then left to whoever started it.
    """
    if not streams:
        sensor.start()
    try:
        until_s = clock.now() + duration_s
        while clock.now() < until_s:
            clock.sleep(_LOOK_EVERY_S)
            sensor.health() if streams else sensor.read()
        yield
    finally:
        if not streams:
            sensor.stop()
