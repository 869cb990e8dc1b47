"""Pages from the templates in ``pages``: one HTML file each, which holds everything it shows and loads nothing."""

import base64
import hashlib
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from labrun.report import text

_TEMPLATES = Path(__file__).with_name("pages")


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table that scrolls by itself where the screen is narrow.

    Attributes
    ----------
    columns
        Headings.
    rows
        One text a column.
    words
        Columns of words, set to the left; all others are numbers, set to the right.
    marked
        Rows that stand out.
    caption
        Above the table.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: Collection[int] = (0,)
    marked: Collection[int] = ()
    caption: str = ""


@dataclass(frozen=True, slots=True)
class PageFigure:
    """A figure inside a page: as SVG, which can be zoomed, as PNG in base64, or why there is none."""

    alt: str
    svg: str = ""
    png: str = ""
    fault: str = ""

    @classmethod
    def of_png(cls, data: bytes, alt: str) -> "PageFigure":
        """Return a picture that is there already."""
        return cls(alt, png=base64.b64encode(data).decode())


def drawn(draw: Callable[[], Any], name: str, alt: str, *, points: bool = False) -> PageFigure | None:
    """Return a figure for a page; None where there is nothing to draw.

    Parameters
    ----------
    draw
        Makes it. If that fails, the page says so: a picture must not cost the numbers beside it.
    name
        Tells its parts from those of the page's other figures.
    alt
        What it shows, for who cannot see it.
    points
        Whether it holds so many points that an SVG would be too large.
    """
    try:
        from labrun.report.style import as_png, as_svg  # matplotlib

        figure = draw()
        if figure is None:
            return None
        if points:
            return PageFigure.of_png(as_png(figure), alt)
        return PageFigure(alt, svg=_inline(as_svg(figure).decode(), name, alt))
    except Exception as error:
        return PageFigure(alt, fault=f"The figure could not be drawn: {type(error).__name__}: {error}")


def render(template: str, context: Mapping[str, Any]) -> str:
    """Return a page; the same context gives the same text, byte for byte. Every text in a page of HTML is escaped."""
    return str(_environment().get_template(template).render(context))


def part(name: str, *values: Any) -> str:
    """Render one macro of ``parts.html.j2``."""
    return str(getattr(_environment().get_template("parts.html.j2").module, name)(*values))


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=select_autoescape(default=True, disabled_extensions=("md.j2",)),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style, script = (_part(name) for name in ("page.css", "zoom.js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    # the browser itself refuses whatever would come from elsewhere, and any script but this one
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    environment.globals |= {"style": style, "script": script, "policy": policy, "text": text}
    return environment


def _part(name: str) -> Markup:
    return Markup((_TEMPLATES / name).read_text(encoding="utf-8"))  # noqa: S704 (our own file)


def _inline(svg: str, name: str, alt: str) -> Markup:
    """Return an SVG file as a part of a page, its names prefixed so that no two figures share one."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.S)
    body = re.sub(r'\b(id="|href="#|url\(#)', rf"\g<1>{name}-", body)
    return Markup(body.replace("<svg", f'<svg role="img" aria-label="{escape(alt)}"', 1))  # noqa: S704 (our own drawing)
