"""Results that show themselves in a notebook."""

from collections.abc import Callable
from pathlib import Path
from typing import Any


def as_html(text: str, figure: Path | None = None) -> str:
    """Return what a notebook shows of a result.

    `text`: what the terminal shows of it. `figure`: its picture, a PNG; left out if it is not there any more.
    """
    import base64
    from html import escape

    picture = ""
    if figure is not None and figure.is_file():
        data = base64.b64encode(figure.read_bytes()).decode()
        picture = (
            f'<img src="data:image/png;base64,{data}" alt="figure of the result" style="max-width: 100%">'
        )
    return f"<div>{picture}<pre>{escape(text)}</pre></div>"


_reporters: list[Callable[[str], Callable[..., str]]] = []


def report_with(reporter: Callable[[str], Callable[..., str]]) -> None:
    """Set what returns the reports' functions by name: results stand below the reports that put them in words."""
    _reporters[:] = [reporter]


def as_reported(name: str, *result: Any) -> str:
    """Return what a notebook shows of a result that a report puts in words.

    `name`: of the report's function, looked up only when a notebook asks; without reports the result's `repr` is shown.
    """
    return as_html(_reporters[0](name)(*result) if _reporters else repr(result[0]))
