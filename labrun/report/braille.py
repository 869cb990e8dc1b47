"""A curve in a terminal, drawn with the dots of braille characters: 2 by 4 of them in each."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_BLANK = 0x2800
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bit of each dot of a character, rows from top to bottom (Unicode 16, block U+2800)."""


def braille_curve(time_s: FloatArray, values: FloatArray, width: int, height: int) -> list[str]:
    """Draw values over time.

    Every column of dots spans what the samples within it do, so that no peak is lost however many there are.

    Parameters
    ----------
    time_s : (n,)
        Increasing.
    values : (n,)
        Values that are not finite are left out.
    width, height
        In characters.

    Returns
    -------
    list of str
        One text of `width` characters a row, from top to bottom; the first is at the largest value, the last at
        the smallest. Empty if there is nothing to draw.
    """
    finite = np.isfinite(values) & np.isfinite(time_s)
    time_s, values = time_s[finite], values[finite]
    if len(values) == 0:
        return []
    columns, rows = 2 * width, 4 * height
    low, high = float(values.min()), float(values.max())
    span_s = float(time_s[-1] - time_s[0])
    share = (time_s - time_s[0]) / span_s if span_s > 0 else np.zeros(len(time_s))
    column = np.minimum((share * columns).astype(int), columns - 1)
    level = (values - low) / (high - low) if high > low else np.full(len(values), 0.5)
    row = np.rint((1.0 - level) * (rows - 1)).astype(int)
    top = np.full(columns, rows)
    bottom = np.full(columns, -1)
    np.minimum.at(top, column, row)
    np.maximum.at(bottom, column, row)
    dots = np.zeros((rows, columns), dtype=bool)
    for left, right in _neighbours(np.flatnonzero(bottom >= 0)):
        _connect(dots, left, (top[left], bottom[left]), right, (top[right], bottom[right]))
    characters = dots.reshape(height, 4, width, 2).transpose(0, 2, 1, 3)
    codes = _BLANK + (characters * _DOTS).sum(axis=(2, 3))
    return ["".join(map(chr, line)) for line in codes]


def _neighbours(filled: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Return each column with samples beside the next one; the last beside itself."""
    return list(zip(filled.tolist(), [*filled[1:].tolist(), int(filled[-1])], strict=True))


def _connect(
    dots: NDArray[np.bool_], left: int, left_span: tuple[int, int], right: int, right_span: tuple[int, int]
) -> None:
    """Draw a column's span, and a line from its middle to the next one's where columns between are empty."""
    first, last = left_span
    if right == left + 1:  # meet the neighbour, so that a steep curve stays one line
        first, last = min(first, right_span[1]), max(last, right_span[0])
    dots[first : last + 1, left] = True
    between = np.arange(left + 1, right)
    start, end = sum(left_span) / 2, sum(right_span) / 2
    dots[np.rint(np.interp(between, [left, right], [start, end])).astype(int), between] = True
