"""Measured k and b of every specimen, the fitted maps and the published ones, and what is left."""

from collections.abc import Sequence

import numpy as np

from labrun.devices import FloatArray
from labrun.fit import Curve, FigureData, Panel, Stack
from labrun_plugins.rigs.hinge.polynomial import FittedMap
from labrun_plugins.rigs.hinge.published import PUBLISHED_RANGE
from labrun_plugins.rigs.hinge.specimens import SIZES, Specimen

_AXES = {"a": "body's area a, cm\N{SUPERSCRIPT TWO}", "l": "hinge length l, mm", "w": "hinge width w, mm"}
_ALIKE = 1e-6
_SCALES: dict[str, tuple[float, str]] = {
    "damping": (1e6, "\N{GREEK SMALL LETTER MU}N m s/rad"), "stiffness": (1e3, "mN m/rad"),
}  # fmt: skip


def maps_figure(maps: Sequence[FittedMap], specimens: Sequence[Specimen], way: str) -> FigureData:
    """Return a row for each quantity, a column for each size that differs between specimens.

    A panel shows the specimens on one line: those that differ from the one where the lines cross in that size only.
    Below it stands how far each specimen lies off the fitted map, with the interval of its releases.
    """
    rows = []
    for one in maps:
        names = [name for name in ("w", "l", "a") if name in one.form.variables]
        rows.append(tuple(_stack(one, name, specimens, way) for name in names))
    told = ", ".join(f"{one.form.label} MAE {one.percent(one.mae):.2g} %" for one in maps)
    return FigureData(f"Hinges over their sizes\n{told}", tuple(rows), legend="top", row_height_in=3.8)


def _stack(one: FittedMap, name: str, specimens: Sequence[Specimen], way: str) -> Stack:
    scale, unit = _SCALES[one.form.quantity]
    size = 1.0 / SIZES[name][1]
    points = one.line(name)
    low, high = one.band(points)
    published = _published(one, name, points, specimens)
    on_line = np.array([_on_line(one, name, place) for place in range(len(specimens))])
    at = size * one.sizes[name][on_line]
    measured, fitted = one.measured[on_line], one.fitted[on_line]
    ends = np.array([specimen.by(way)[1][one.form.quantity].ci95 for specimen in specimens])[on_line]
    curves = [
        Curve(
            size * points[name], scale * one.value(points), "fitted", "fitted map, 95 % band", "band",
            (scale * low, scale * high),
        ),
    ]  # fmt: skip
    if np.isfinite(published).any():
        curves.append(Curve(size * points[name], scale * published, "residual", "published map", dashed=True))
    curves.append(
        Curve(
            at, scale * measured, "point", "measured, 95 % (releases)", "points",
            (scale * ends[:, 0], scale * ends[:, 1]),
        )
    )  # fmt: skip
    values = scale * np.concatenate([ends.ravel(), one.value(points), published[np.isfinite(published)]])
    room = 0.12 * float(np.ptp(values))
    off, bars = 100.0 * (measured / fitted - 1.0), [100.0 * (ends[:, side] / fitted - 1.0) for side in (0, 1)]
    limit = 1.25 * max(float(np.max(np.abs([off, *bars]))), 0.1)
    others = [
        f"{other} = {value / SIZES[other][1]:g} {_AXES[other].rpartition(', ')[2]}"
        for other, value in one.crossing.items()
        if other != name
    ]
    upper = Panel(
        tuple(curves),
        title=f"{one.form.symbol} over {name}" + (f" at {', '.join(others)}" if others else ""),
        y_label=f"{one.form.quantity} {one.form.symbol}, {unit}",
        y_range=(float(values.min()) - room, float(values.max()) + room),
        zero=bool(values.min() - room < 0),
        height=2.4,
    )
    lower = Panel(
        (Curve(at, off, "residual", kind="points", spread=(np.minimum(*bars), np.maximum(*bars))),),
        x_label=_AXES[name],
        y_label="off the map, %",
        y_range=(-limit, limit),
        zero=True,
    )
    return Stack((upper, lower))


def _published(
    one: FittedMap, name: str, points: dict[str, FloatArray], specimens: Sequence[Specimen]
) -> FloatArray:
    """Return the published map along a line, nan where it may not be read."""
    values = np.full(len(points[name]), np.nan)
    readable = any(np.isfinite(one.form.published_value(specimen.sizes)) for specimen in specimens)
    if one.form.published is not None and readable:
        low, high = PUBLISHED_RANGE[name]
        for place in np.flatnonzero((points[name] >= low) & (points[name] <= high)):
            values[place] = one.form.published.value({other: at[place] for other, at in points.items()})
    return values


def _on_line(one: FittedMap, name: str, place: int) -> bool:
    return all(
        abs(one.sizes[other][place] / value - 1) <= _ALIKE
        for other, value in one.crossing.items()
        if other != name
    )
