"""Results that show themselves in a notebook."""

import base64
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any


def as_html(text: str, figure: Path | None = None) -> str:
    """Return what a notebook shows of a result.

    `told`: what the terminal shows of it. `figure`: its picture, a PNG; left out if it is not there any more.
    """
    picture = ""
    if figure is not None and figure.is_file():
        data = base64.b64encode(figure.read_bytes()).decode()
        picture = (
            f'<img src="data:image/png;base64,{data}" alt="figure of the result" style="max-width: 100%">'
        )
    return f"<div>{picture}<pre>{escape(text)}</pre></div>"


def as_reported(words: str, *result: Any) -> str:
    """Return what a notebook shows of a result whose words stand in `labrun.report`.

    `words`: the function there that makes them, looked up only when a notebook asks: results stand below the report.
    """
    return as_html(getattr(import_module("labrun.report"), words)(*result))
