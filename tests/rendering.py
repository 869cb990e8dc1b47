"""Figures without their pixels.

Layout and rendering take most of the time of a short run, and few tests look at a picture. Figures are made as always,
but written as an empty picture of the same format, except in a test with the marker `rendered` and inside `rendered()`.
"""

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

_save, _lay_out = Figure.savefig, ConstrainedLayoutEngine.execute


class _State:
    rendered = False


def leave_pictures_empty() -> None:
    """From now on, write empty pictures in this process."""
    Figure.savefig = _savefig
    ConstrainedLayoutEngine.execute = _execute


@contextmanager
def rendered() -> Iterator[None]:
    """Render figures inside the context."""
    before, _State.rendered = _State.rendered, True
    try:
        yield
    finally:
        _State.rendered = before


def _savefig(figure: Figure, file: Any, **options: Any) -> None:
    if _State.rendered:
        _save(figure, file, **options)
        return
    kind = options.get("format") or Path(file).suffix[1:]
    if hasattr(file, "write"):
        file.write(_empty(kind))
    else:
        Path(file).write_bytes(_empty(kind))


def _execute(engine: ConstrainedLayoutEngine, figure: Figure) -> Any:
    return _lay_out(engine, figure) if _State.rendered else None


@functools.cache
def _empty(kind: str) -> bytes:
    buffer = BytesIO()
    _save(Figure(figsize=(0.1, 0.1)), buffer, format=kind)
    return buffer.getvalue()
