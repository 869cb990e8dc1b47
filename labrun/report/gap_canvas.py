"""A figure whose texts are names from people's files: a dollar sign is a dollar sign, not the start of a formula."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from labrun.report.style import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@contextmanager
def plain_figure(width_in: float, height_in: float) -> "Iterator[Figure]":
    """Make a figure in labrun's style that takes every text as it stands; draw on it inside the context."""
    from matplotlib import rc_context

    with new_figure(width_in, height_in) as figure, rc_context({"text.parse_math": False}):
        yield figure
