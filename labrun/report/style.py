"""How figures look: one style for all, readable in print, safe for colour-blind eyes."""

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogFormatter

INK = "#1a1a1a"
SOFT = "#8a8a8a"
FAINT = "#d9d9d9"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#6a51a3", "#000000")
"""Okabe & Ito (2008), told apart by all common kinds of colour vision; yellow, too light for lines, is replaced."""
DIVERGING = "RdBu_r"
"""Of values of both signs, centred at zero."""
SEQUENTIAL = "viridis"
"""Of values of one sign."""
BEST = "#111111"
DPI = 160
_HEADING_IN = 0.46
_TITLE_PT = 12.5
_TITLE_CHARACTERS_PER_IN = 9.2
"""Of a title at its full size; a longer one is written smaller."""
_LINE_IN = 0.155
_CHARACTERS_PER_IN = 12.8

_RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 6.0,
    "axes.labelsize": 9.0,
    "axes.unicode_minus": True,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "hatch.linewidth": 0.5,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.hashsalt": "labrun",
    "svg.fonttype": "path",
    "text.parse_math": False,
}


@contextmanager
def new_figure(width_in: float, height_in: float) -> Iterator[Figure]:
    """Make a figure in labrun's style; draw on it inside the context.

    Texts are names from people's files and are taken as they stand: a dollar sign begins no formula.
    """
    with rc_context(_RC):
        layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06, wspace=0.03, hspace=0.03)
        figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout=layout)
        FigureCanvasAgg(figure)
        yield figure


def as_svg(figure: Figure) -> bytes:
    """Return a figure as SVG, the same bytes for the same drawing.

    Letters become outlines, so that it looks alike where the font is missing.
    """
    return _written(figure, "svg", {"Date": None, "Creator": None})


def as_png(figure: Figure) -> bytes:
    """Return a figure as PNG, the same bytes for the same drawing."""
    return _written(figure, "png", {"Software": None})


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG; whole or not at all."""
    temporary = path.with_name(f".{path.name}.partial")
    temporary.write_bytes(as_png(figure))
    temporary.replace(path)
    return path


def _written(figure: Figure, kind: str, metadata: dict[str, None]) -> bytes:
    buffer = BytesIO()
    with rc_context(_RC):
        engine = figure.get_layout_engine()
        if engine is not None:  # savefig would draw everything once more to lay it out
            engine.execute(figure)
            engine.execute(figure)  # other heights have other ticks, whose numbers may be longer
            figure.set_layout_engine(None)
        figure.savefig(buffer, dpi=DPI, format=kind, metadata=metadata)
    return buffer.getvalue()


def heading_height_in(width_in: float, subtitle: str) -> float:
    """Return what `heading` takes of a figure's height, inches."""
    return _HEADING_IN + _LINE_IN * len(_wrapped(subtitle, width_in))


def _wrapped(subtitle: str, width_in: float) -> list[str]:
    whole = subtitle.replace(" = ", "\u00a0=\u00a0")  # a line never ends between a name and its value
    return textwrap.wrap(whole, int(width_in * _CHARACTERS_PER_IN), break_on_hyphens=False)


def heading(figure: Figure, title: str, subtitle: str) -> None:
    """Put the title, and below it what the reader has to know, over the whole figure."""
    width, height = (float(side) for side in figure.get_size_inches())
    lines = _wrapped(subtitle, width)
    band = heading_height_in(width, subtitle) / height
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - band))
    size = min(_TITLE_PT, _TITLE_PT * _TITLE_CHARACTERS_PER_IN * width / max(len(title), 1))
    figure.text(0.012, 1 - 0.10 / height, title, ha="left", va="top", fontsize=size, fontweight="bold")
    figure.text(0.012, 1 - 0.36 / height, "\n".join(lines), ha="left", va="top", fontsize=9, color="#444444")


def annotate_point(
    axes: Axes, text: str, at: tuple[float, float], offset_pt: tuple[float, float] = (4, 0), **look: Any
) -> None:
    """Write a text so far from a point of the data."""
    axes.annotate(text, at, xytext=offset_pt, textcoords="offset points", **look)


def legend_above(axes: Axes, **look: Any) -> None:
    """Put the legend over the right end of the axes, in one line."""
    look = {"ncols": 5, "borderaxespad": 0.2, **look}
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), **look)


def zero_line(axes: Axes) -> None:
    """Mark zero if it lies within the axes."""
    low, high = axes.get_ylim()
    if low < 0 < high:
        axes.axhline(0, color=SOFT, linewidth=0.7, zorder=0)


def plain_numbers(axis: XAxis | YAxis) -> None:
    """Write the ticks of a logarithmic axis as numbers, 0.01, rather than as powers of ten.

    Those between powers of ten have numbers only where the axis shows one such power or none.
    """
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(_BetweenDecades(minor_thresholds=(1, 0.4)))


class _BetweenDecades(LogFormatter):
    """Which minor ticks have a number is matplotlib's rule, how it is written is not."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def panel_letter(axes: Axes, letter: str, title: str) -> None:
    """Name a panel: bold letter, then what it shows."""
    axes.set_title(f"     {title}")
    axes.annotate(
        letter, (0, 1), xytext=(0, 6), xycoords="axes fraction", textcoords="offset points", fontweight="bold"
    )
