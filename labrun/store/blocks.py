"""Reading a dataset in blocks of bounded size."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from h5py import h5d, h5s

from labrun.devices.samples import FloatArray

BLOCK = 1 << 17
"""Samples of one dataset that are handled at a time (1 MiB), and the chunk of a dataset that grows."""


def blocks(dataset: h5d.DatasetID, first: int = 0, count: int | None = None) -> Iterator[FloatArray]:
    """Yield a part of a one-dimensional dataset (all of it without `count`), `BLOCK` values at a time."""
    (length,) = dataset.shape
    count = length - first if count is None else count
    if count == length <= BLOCK:
        values = np.empty(count)
        if count:
            dataset.read(h5s.ALL, h5s.ALL, values)
        yield values
        return
    where = dataset.get_space()
    for start in range(first, first + count, BLOCK):
        values = np.empty(min(BLOCK, first + count - start))
        where.select_hyperslab((start,), (len(values),))
        dataset.read(extent(len(values)), where, values)
        yield values


@lru_cache(maxsize=256)
def extent(length: int) -> h5s.SpaceID:
    """Return the space of so many values in memory."""
    return h5s.create_simple((length,))


class ReadAhead:
    """A dataset of many trials: once one trial is read after the other, a block serves all that stand in it."""

    def __init__(self, dataset: h5d.DatasetID) -> None:
        self._dataset = dataset
        self._block = np.empty(0)
        self._start = 0
        self._end_of_last = 0

    def blocks(self, first: int, count: int) -> Iterator[FloatArray]:
        """Yield a part of it, at most `BLOCK` values at a time."""
        follows, self._end_of_last = first == self._end_of_last, first + count
        if self._start <= first and first + count <= self._start + len(self._block):
            yield self._block[first - self._start : first - self._start + count]
        elif follows and count <= BLOCK // 2:
            ahead = min(BLOCK, self._dataset.shape[0] - first)
            self._start, self._block = first, next(blocks(self._dataset, first, ahead))
            yield self._block[:count]
        else:
            yield from blocks(self._dataset, first, count)
