"""Blocks of voltages as bytes, the way a program of one's own serves them to ``reader = "socket"``.

A block is ``LRV1 | count u32 | first u64 | count x 6 x f64``, all big-endian: how many samples, the number of the first
one since the start, and the voltages of gauge 1 to 6 of each.
"""

import struct

import numpy as np

from labrun_plugins.ati_daq.reader import Voltages
from labrun_plugins.ati_daq.settings import GAUGES

MAGIC = b"LRV1"
MOST_SAMPLES = 16_384
_HEADER = struct.Struct(">4sIQ")
_SAMPLE_BYTES = 8 * GAUGES
_FARTHEST = 1 << 53


class BlockParser:
    """Puts blocks together from whatever pieces arrive. After bytes that are no block, `broken` says so for ever."""

    def __init__(self) -> None:
        self.broken = False
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Voltages]:
        """Take bytes; return the blocks that are complete."""
        if self.broken:
            return []
        self._rest += data
        blocks: list[Voltages] = []
        while len(self._rest) >= _HEADER.size:
            magic, count, first = _HEADER.unpack_from(self._rest)
            if magic != MAGIC or not 1 <= count <= MOST_SAMPLES or first > _FARTHEST:
                self.broken = True
                self._rest.clear()
                break
            end = _HEADER.size + count * _SAMPLE_BYTES
            if len(self._rest) < end:
                break
            values = np.frombuffer(bytes(self._rest[_HEADER.size : end]), ">f8").reshape(count, GAUGES)
            blocks.append(Voltages(first, values.astype(float)))
            del self._rest[:end]
        return blocks
