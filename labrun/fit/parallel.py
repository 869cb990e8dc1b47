"""Doing many independent things at once, in their order: the same results whatever the number of workers."""

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")

_OF_THREAD = threading.local()
"""In a thread of `workers`: the event that tells it to stop."""


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

    An error, or Ctrl-C, ends what is still under way at its next call of `stop_if_told`: nobody waits for fits whose
    results are not wanted any more.
    """
    if count <= 1:
        yield one_by_one
        return
    stop = threading.Event()

    def begin() -> None:
        _OF_THREAD.stop = stop

    with ThreadPoolExecutor(count, initializer=begin) as pool:

        def each(work: Callable[[Argument], Result], items: Iterable[Argument]) -> list[Result]:
            return list(pool.map(work, items))

        try:
            yield each
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def stop_if_told() -> None:
    """End the work of this thread if its results are not wanted any more; long work calls it often.

    Raises
    ------
    CancelledError
        In a thread of `workers` only.
    """
    stop = getattr(_OF_THREAD, "stop", None)
    if stop is not None and stop.is_set():
        raise CancelledError
