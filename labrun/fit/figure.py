"""What a fit shows, as plain data: panels of curves that `labrun.report` draws in its own style."""

from dataclasses import dataclass
from typing import Literal

from labrun.arrays import FloatArray

Role = Literal["measured", "fitted", "residual", "alternative", "limit", "point"]


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve of a panel.

    Attributes
    ----------
    x, y : (n,)
    role
        What it shows, or the number of its series: the report gives each a colour of its own.
    label
        In the legend; none if empty.
    kind
        How it is drawn: "points" and "bars" with `spread` as error bars, "band" between its ends.
    spread : two of (n,)
        Lower and upper end.
    bold, dashed
        Of a line.
    """

    x: FloatArray
    y: FloatArray
    role: Role | int = "fitted"
    label: str = ""
    kind: Literal["line", "steps", "points", "bars", "band"] = "line"
    spread: tuple[FloatArray, FloatArray] | None = None
    bold: bool = False
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes.

    Attributes
    ----------
    note
        At the right above the axes.
    x_range, y_range
        What is shown; what the curves need if None.
    log
        Which axes are logarithmic: "", "x" or "xy".
    zero
        Whether a line is drawn at y = 0.
    equal
        Whether a unit is as long on both axes.
    ticks
        Names of the places 0, 1, 2 ... along x.
    shaded
        Part of x that another panel shows enlarged.
    height
        Relative to the other panels of its stack.
    """

    curves: tuple[Curve, ...]
    title: str = ""
    note: str = ""
    x_label: str = ""
    y_label: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: Literal["", "x", "xy"] = ""
    zero: bool = False
    equal: bool = False
    ticks: tuple[str, ...] = ()
    shaded: tuple[float, float] | None = None
    height: float = 1.0


@dataclass(frozen=True, slots=True)
class Stack:
    """Panels above one another; `shared_x` if all have the same x, told below the lowest only."""

    panels: tuple[Panel, ...]
    shared_x: bool = True
    width: float = 1.0


@dataclass(frozen=True, slots=True)
class FigureData:
    """A figure: rows of stacks under a title.

    Attributes
    ----------
    legend
        "panel": in every panel whose curves have labels; "top": once, below the title.
    row_height_in
        Height of each row, inches.
    """

    title: str
    rows: tuple[tuple[Stack, ...], ...]
    legend: Literal["panel", "top"] = "panel"
    row_height_in: float = 3.6
