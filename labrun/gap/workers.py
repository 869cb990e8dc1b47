"""Doing many independent things at once, in their order: the same results whatever the number of workers."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")


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
    """Give a `map` over threads: compiled simulations run beside each other, since they do not hold Python's lock."""
    if count <= 1:
        yield one_by_one
        return
    with ThreadPoolExecutor(count) as pool:

        def each(work: Callable[[Argument], Result], items: Iterable[Argument]) -> list[Result]:
            return list(pool.map(work, items))

        yield each
