"""Run many simulations in parallel, in order and counted, with a cache of the latest."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from threading import Lock
from typing import Protocol, TypeVar

from labrun.models import Unfiltered

Argument = TypeVar("Argument")
Result = TypeVar("Result")

_OF_THREAD = threading.local()
"""Of each thread, as `unwanted`: the events that tell it that what it works on is not wanted any more."""


class Each(Protocol):
    """A `map` that returns a list."""

    def __call__(self, work: Callable[[Argument], Result], items: Iterable[Argument], /) -> list[Result]:
        """Return what `work` gives for every item, in their order."""
        ...


def one_by_one(work: Callable[[Argument], Result], items: Iterable[Argument]) -> list[Result]:
    """Do one thing after the other."""
    return [work(item) for item in items]


@contextmanager
def workers(count: int) -> Iterator[Each]:
    """Give a `map` over threads: compiled simulations run beside each other, since they do not hold Python's lock.

    Whoever calls it works, too, and idle threads join in: so it may be called inside of its own work, and nobody waits
    but for what is under way. Once the threads have ended, it does one thing after the other.

    An error, or Ctrl-C, ends what is still under way at its next call of `stop_if_told`: nobody waits for fits whose
    results are not wanted any more.
    """
    if count <= 1:
        yield one_by_one
        return
    ended = threading.Event()
    with ThreadPoolExecutor(count - 1) as pool:

        def each(work: Callable[[Argument], Result], items: Iterable[Argument]) -> list[Result]:
            if ended.is_set():
                return one_by_one(work, items)
            items, unwanted = list(items), threading.Event()
            events = (*_unwanted(), unwanted)
            positions, results = iter(range(len(items))), dict[int, Result]()

            def take() -> None:
                before = _unwanted()
                _OF_THREAD.unwanted = events
                try:
                    for position in positions:  # whichever thread asks first
                        stop_if_told()
                        results[position] = work(items[position])
                except BaseException:
                    unwanted.set()
                    raise
                finally:
                    _OF_THREAD.unwanted = before

            running = [take]

            def join() -> None:
                for task in tuple(running):
                    task()

            try:
                others = [pool.submit(join) for _ in range(min(count, len(items)) - 1)]
                with suppress(CancelledError):  # what made it unwanted is told by another thread
                    take()
                wrong = [error for future in others if not future.cancel() and (error := future.exception())]
            except BaseException:
                unwanted.set()
                raise
            finally:
                running.clear()  # what still waits in the queue of busy threads must not hold the results
            if len(results) < len(items):
                raise min(
                    wrong, key=lambda error: isinstance(error, CancelledError), default=CancelledError()
                )
            return [results[index] for index in range(len(items))]

        try:
            yield each
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        finally:
            ended.set()


def stop_if_told() -> None:
    """End the work of this thread if its results are not wanted any more; long work calls it often.

    Raises CancelledError: in work of `workers` only.
    """
    if any(event.is_set() for event in _unwanted()):
        raise CancelledError


def _unwanted() -> tuple[threading.Event, ...]:
    unwanted: tuple[threading.Event, ...] = getattr(_OF_THREAD, "unwanted", ())
    return unwanted


_MOST_BYTES = 128_000_000
_FEW = 0.005
"""Share of simulations below which a sentence gives one more digit."""


class Simulations:
    """Counts simulations of a model by itself, and keeps the last ones up to the effects at their outputs.

    Shared by all problems that are made from one, and by threads.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[Hashable, tuple[Unfiltered, object]] = OrderedDict()
        self._bytes = 0
        self.made = 0
        self.broken = 0

    def count(self, *, finite: bool) -> None:
        """Count one simulation of one trial."""
        with self._lock:
            self.made += 1
            self.broken += not finite

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence if some simulations broke; nothing else."""
        if not self.broken:
            return ()
        share = self.broken / self.made
        percent = f"{100 * share:.{1 if share < _FEW else 0}f} %"
        return (
            f"{self.broken} of {self.made} simulations of the model ({percent}) left the finite numbers while "
            "its parameters were fitted: part of what is believed of them does not simulate, and was not searched.",
        )

    def get(self, key: Hashable, make: Callable[[], Unfiltered], holds: object = None) -> Unfiltered:
        """Return the simulation of that key, without its states; `make` simulates if it is not there.

        Parameters
        ----------
        holds
            What the key names by its `id`, which is another's once it is gone: kept as long as the key.
        """
        with self._lock:
            kept = self._kept.get(key)
            if kept is not None:
                self._kept.move_to_end(key)
                return kept[0]
        made = make()
        made = replace(made, states=made.states[:, :0].copy())  # nobody asks for them, and they are large
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made, holds
                self._bytes += _size(made)
            while self._bytes > _MOST_BYTES and len(self._kept) > 1:
                self._bytes -= _size(self._kept.popitem(last=False)[1][0])
        return made

    def __reduce__(self) -> tuple[type["Simulations"], tuple[()]]:
        """Travel empty: what is kept holds memory of this process, and locks do not travel."""
        return Simulations, ()


def _size(filtered_signals: Unfiltered) -> int:
    return filtered_signals.outputs.nbytes + filtered_signals.states.nbytes
