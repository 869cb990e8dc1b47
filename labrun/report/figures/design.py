"""The drawing of a finished design, to scale."""

import textwrap
from collections.abc import Mapping

from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from labrun.design import Drawing
from labrun.report.style import COLOURS, INK, SOFT, annotate_point, new_figure
from labrun.report.text import quantity_text

_MM_PER_IN = 25.4
_SCALES = (1, 2, 5, 10, 20, 50, 100)
_LARGEST_MM = 260.0
_MARGIN_MM = 12.0
_SIZES_MM = 34.0
_TABLE_MM = 62.0
_LINE_MM = 5.5
_LETTER_MM = 2.3


def draw_design(drawing: Drawing, units: Mapping[str, str], title: str) -> Figure:
    """Draw the parts so that a millimetre is a millimetre, or the half, fifth, ... of one that is said.

    `drawing`: parts and dimensions. `units`: of the dimensions, by name. `title`: over the drawing.
    """
    left, right, low, high = drawing.extent_mm
    scale = next(
        (candidate for candidate in _SCALES if max(right - left, high - low) / candidate <= _LARGEST_MM),
        _SCALES[-1],
    )
    margin = _MARGIN_MM * scale
    wide, tall = right - left + 2 * margin, high - low + 2 * margin
    rows = len(drawing.dimensions) + 3
    width_mm = max(wide / scale + _SIZES_MM + _TABLE_MM, 110.0)
    title_lines = textwrap.wrap(title, int(width_mm / _LETTER_MM))
    height_mm = max(tall / scale, _LINE_MM * rows) + 5.0 + _LINE_MM * len(title_lines)
    with new_figure(width_mm / _MM_PER_IN, height_mm / _MM_PER_IN) as figure:
        figure.set_layout_engine("none")
        axes = figure.add_axes((0.0, 0.0, wide / scale / width_mm, tall / scale / height_mm))
        axes.set_xlim(left - margin, right + margin)
        axes.set_ylim(low - margin, high + margin)
        axes.set_axis_off()
        names = list(dict.fromkeys(part.name.removesuffix(" (mirrored)") for part in drawing.parts))
        for part in drawing.parts:
            plain = part.name.removesuffix(" (mirrored)")
            colour = COLOURS[names.index(plain) % len(COLOURS)]
            corners = part.corners_mm()
            axes.add_patch(
                Polygon(corners, closed=True, facecolor=colour, alpha=0.3, edgecolor=INK, linewidth=0.8)
            )
            ends = (part.x_mm, part.end_mm[0]), (part.y_mm, part.end_mm[1])
            axes.plot(*ends, color=SOFT, linewidth=0.5, linestyle=(0, (6, 3)))
            if plain == part.name:
                edge = max(x for x, _ in corners), sum(ends[1]) / 2
                size = f"{plain} {part.length_mm:.1f} x {part.width_mm:.1f} mm"
                annotate_point(axes, size, edge, (5, 0), fontsize=7.5, va="center", color=INK)
        across = 1 - _TABLE_MM / width_mm
        figure.text(
            0.02,
            1 - 3.0 / height_mm,
            "\n".join(title_lines),
            fontsize=10,
            fontweight="bold",
            va="top",
            color=INK,
        )
        lines = [f"scale 1:{scale}", ""]
        for name, (value, tolerance) in drawing.dimensions.items():
            unit = units.get(name, "")
            lines.append(f"{name} = {value:.1f} ± {tolerance:g} {unit}".rstrip())
        figure.text(
            across,
            1 - (8.0 + _LINE_MM * len(title_lines)) / height_mm,
            "\n".join(lines),
            fontsize=8.5,
            va="top",
            linespacing=1.6,
            color=INK,
        )
        figure.text(
            across,
            4.0 / height_mm,
            f"whole: {quantity_text(right - left, 'mm')} x {quantity_text(high - low, 'mm')}",
            fontsize=8,
            color=INK,
        )
    return figure
