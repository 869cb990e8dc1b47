"""What the maps of chapter 3 show, and what to know before trusting them; the tables and the figure of them."""

import itertools
from collections.abc import Sequence

import numpy as np

from labrun.devices import FloatArray
from labrun.fit import FEW_TRIALS, Curve, Estimate, FigureData, Panel, Stack, TextTable, rounded
from labrun_plugins.rigs.hinge.body import FOUND
from labrun_plugins.rigs.hinge.polynomial import PUBLISHED, PUBLISHED_RANGE, UNITS, FittedMap, Quantity
from labrun_plugins.rigs.hinge.specimens import SIZES, Specimen

NONE = "-"


def specimen_table(one: FittedMap, specimens: Sequence[Specimen], way: str) -> TextTable:
    """Return one row a specimen: measured with interval, the fitted map, the published map."""
    published = [one.form.published_value(specimen.sizes) for specimen in specimens]
    rows = []
    for specimen, measured, fitted, other in zip(specimens, one.measured, one.fitted, published, strict=True):
        estimate = specimen.by(way)[1][one.form.quantity]
        value, low, high = rounded(estimate)
        rows.append(
            (
                specimen.label, str(len(specimen.values)), value, f"{low} ... {high}",
                f"{fitted:.3e}", f"{100 * (measured / fitted - 1):+.1f} %",
                f"{other:.3e}" if np.isfinite(other) else NONE,
                f"{100 * (measured / other - 1):+.1f} %" if np.isfinite(other) and other > 0 else NONE,
            )
        )  # fmt: skip
    number = one.form.published.equation if one.form.published is not None else "published"
    symbol, unit = one.form.symbol, UNITS[one.form.quantity]
    header = ("specimen", "releases", symbol, "95 % interval", "map", "off it", number, "off it")
    return TextTable(f"{symbol} of every specimen, {unit}", header, tuple(rows))


def quality_table(maps: Sequence[FittedMap]) -> TextTable:
    """Return one row a map: its errors beside those the source printed for (3.11) and (3.12), and its conditioning."""
    rows = []
    for one in maps:
        own = next(
            known for (quantity, _), known in PUBLISHED.items() if quantity == one.form.quantity and known.mae
        )
        rows.append(
            (
                one.form.label, str(len(one.measured)), str(len(one.form.terms)), f"{one.mae:.2e}",
                _percent(one.percent(one.mae)), _percent(one.percent(one.left_out_mae)),
                f"{own.mae:.2e}", f"{_percent(own.mae_percent)} {own.equation}",
                f"{one.condition:.3g}", f"{one.raw_condition:.2g}",
            )
        )  # fmt: skip
    header = (
        "map", "specimens", "coefficients", "MAE", "MAE", "leave one out", "source", "source", "condition", "in m, m^2",
    )  # fmt: skip
    return TextTable(
        "mean absolute error, % of the mean; condition number, centred and scaled and not",
        header,
        tuple(rows),
    )


def coefficient_table(one: FittedMap) -> TextTable:
    """Return the coefficients with both intervals, beside the published ones."""
    published = {} if one.form.published is None else one.form.published.coefficients
    rows = []
    for place, (name, term) in enumerate(zip(one.form.names, one.form.terms, strict=True)):
        value = float(one.coefficients[place])
        rows.append(
            (
                name,
                NONE if one.undetermined[place] else f"{value:.4g}",
                NONE if one.undetermined[place] else _interval(value, one.by_releases[place]),
                NONE if one.undetermined[place] else _interval(value, one.by_scatter[place]),
                f"{published[term]:.5g}" if term in published else NONE,
            )
        )
    number = one.form.published.equation if one.form.published is not None else "published"
    header = ("coefficient", "value", "95 %, releases alone", "95 %, scatter of specimens", number)
    return TextTable(f"{one.form.label}: where its intervals come from", header, tuple(rows))


def _interval(value: float, ends: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    if not np.isfinite(ends).all():
        return NONE
    _, low, high = rounded(Estimate(value, (float(ends[0]), float(ends[1])), ""))
    return f"{low} ... {high}"


def _percent(value: float | None) -> str:
    return NONE if value is None or not np.isfinite(value) else f"{value:.2f} %"


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


_FEW_FREEDOMS = 3
_NEARLY_COLLINEAR = 30.0
"""Condition number of centred and scaled regressors from which coefficients trade against one another."""
_SHOWN = 3
_NORMAL = 1.96
_ABOVE_RELEASES = 2.0
_BOX = 25
"""Points along each edge of the box in which negative values are looked for."""


def findings(
    maps: Sequence[FittedMap], other: Sequence[FittedMap], specimens: Sequence[Specimen], way: str
) -> list[str]:
    """Return what the maps show."""
    told = []
    for one in maps:
        known = _published_mae(one, specimens)
        if one.form.published is not None and np.isfinite(known):
            told.append(
                f"on these specimens the published map {one.form.published.equation} has a mean absolute error of "
                f"{known:.2e} {UNITS[one.form.quantity]} ({one.percent(known):.1f} % of the mean)"
                f"{_comprehensive(one, specimens)}; {one.form.label} as fitted {one.percent(one.mae):.1f} %"
            )
    told += [_scatter(one) for one in maps if np.isfinite(one.scatter) and np.isfinite(one.release_scatter)]
    if all(one.form.quantity != "stiffness" for one in maps):
        told.append(_one_stiffness(specimens, way))
    apart = [
        (one, float(np.max(np.abs(one.measured / two.measured - 1.0))))
        for one, two in zip(maps, other, strict=True)
    ]
    told.append(
        "Fourier derivatives and simulation differ by at most "
        + " and ".join(f"{100 * size:.2g} % in {one.form.symbol}" for one, size in apart)
        + " of a specimen"
    )
    return told


def map_warnings(one: FittedMap) -> list[str]:
    """Return what a map's coefficients cannot be trusted for."""
    label, told = one.form.label, []
    names = np.array(one.form.names)
    open_ = names[one.undetermined].tolist()
    if len(open_):
        told.append(
            f"{label}: the specimens do not determine {_listed(open_)}; they are left out of the estimates. Only a "
            "combination of them is known: vary one size while the others stay, at three sizes or more"
        )
    elif one.condition > _NEARLY_COLLINEAR:
        told.append(
            f"{label}: the regressors are nearly collinear (condition number {one.condition:.2g}, centred and scaled): "
            "coefficients trade against one another, and only the map's values between the specimens mean something"
        )
    if one.freedom == 0:
        told.append(
            f"{label}: {len(one.measured)} specimens for {len(one.form.terms)} coefficients: the map goes through all "
            "of them, nothing is left to judge it by, and the intervals know of releases only"
        )
    elif one.freedom < _FEW_FREEDOMS:
        told.append(
            f"{label}: {len(one.measured)} specimens for {len(one.form.terms)} coefficients leave "
            f"{one.freedom} degree{'s' * (one.freedom != 1)} of freedom: intervals are wide, and the error of "
            "specimens it was fitted to flatters the map; leave one out tells more"
        )
    zero = [
        name for name, estimate in one.estimates.items() if estimate.contains_zero and not name.endswith("_0")
    ]
    if len(zero) == 1:
        told.append(f"{label}: {zero[0]} cannot be told from zero: these specimens would do without it")
    elif zero:
        told.append(
            f"{label}: {_listed(zero)} cannot be told from zero, each by itself: the specimens do not determine how "
            "they share what changes with size"
        )
    straight = [name for name in one.form.variables if (name, 2) not in one.form.terms]
    if straight:
        told.append(
            f"{label}: two sizes of {_listed(straight)} only: a straight line, where the source has a parabola"
        )
    if one.form.published is None:
        told.append(f"{label}: the source has no map over just these sizes to compare with")
    return [*told, *_negative(one)]


def warnings(maps: Sequence[FittedMap], specimens: Sequence[Specimen], way: str) -> list[str]:
    """Return what concerns all maps."""
    told = []
    for one in maps:
        labels = [one_.label for one_ in specimens if not np.isfinite(one.form.published_value(one_.sizes))]
        if labels and one.form.published is not None:
            told.append(
                f"{one.form.published.equation} is not compared with {_capped(labels)}: the specimen is outside of the "
                "sizes it was fitted to, or not nominal otherwise (50 mm wide, 1.75 mm long, 43 cm^2)"
            )
    few = [one.label for one in specimens if len(one.values) < FEW_TRIALS]
    if few:
        told.append(
            f"fewer than {FEW_TRIALS} releases of {_capped(few)}: intervals of these specimens are coarse"
        )
    if _each_once(specimens):
        told.append(
            "every specimen was mounted once: what a mounting changes (2 to 3 % in the source's repeats) is in the "
            "scatter about the map, and cannot be told from a size's own effect; another run tells (--with RUN)"
        )
    told += _body(specimens, way, [one.form.quantity for one in maps])
    own = [f"{one.label}: {text}" for one in specimens for text in one.warnings]
    told += own[:_SHOWN]
    if len(own) > _SHOWN:
        told.append(f"more on single specimens ({len(own) - _SHOWN}) is stored with the fit")
    return told


def _published_mae(one: FittedMap, specimens: Sequence[Specimen]) -> float:
    """Return the mean absolute error of the published map on these specimens; nan if it may be read at none."""
    published = np.array([one.form.published_value(specimen.sizes) for specimen in specimens])
    error = np.abs(one.measured - published)
    return float(np.nanmean(error)) if np.isfinite(error).any() else float("nan")


def _negative(one: FittedMap) -> list[str]:
    """Return where along the lines of specimens the map is negative, and in how much of the box around them."""
    told = []
    for name in one.form.variables:
        points = one.line(name)
        values = one.value(points)
        below = points[name][values <= 0]
        if len(below):
            condition, factor = SIZES[name]
            unit = condition.rpartition("_")[2].replace("cm2", "cm^2")
            told.append(
                f"{one.form.label} turns negative between specimens, at {name} = {below[0] / factor:.3g} to "
                f"{below[-1] / factor:.3g} {unit} (least: {values.min():.2g} {UNITS[one.form.quantity]}): do not use "
                "it there, and measure a specimen there"
            )
    if len(one.form.variables) > 1:
        axes = [np.linspace(values.min(), values.max(), _BOX) for values in one.sizes.values()]
        grid = np.array(list(itertools.product(*axes))).T
        share = float(np.mean(one.value(dict(zip(one.sizes, grid, strict=True))) <= 0))
        if share > 0:
            told.append(
                f"{one.form.label} is negative in {100 * share:.2g} % of the box that the specimens span, off the "
                "lines along which they were varied: nothing was measured there, and the map says nothing about it"
            )
    return told


def _scatter(one: FittedMap) -> str:
    size, releases = one.percent(one.scatter), one.percent(one.release_scatter)
    text = (
        f"specimens lie {size:.2g} % (standard deviation) off {one.form.label}; releases of a specimen account for "
        f"{releases:.2g} %"
    )
    if size > _ABOVE_RELEASES * releases:
        text += ": the rest is how specimens are made and mounted, or a shape the polynomial lacks"
    return text


def _comprehensive(one: FittedMap, specimens: Sequence[Specimen]) -> str:
    """Tell what the source's map over all sizes makes of the specimens: its maps do not agree with one another."""
    whole = next(
        known for (quantity, _), known in PUBLISHED.items() if quantity == one.form.quantity and known.mae
    )
    if whole is one.form.published:
        return ""
    error = np.mean([abs(y - whole.value(at.sizes)) for y, at in zip(one.measured, specimens, strict=True)])
    return f", its {whole.equation} over all sizes {one.percent(float(error)):.1f} %"


def _one_stiffness(specimens: Sequence[Specimen], way: str) -> str:
    k = np.array([float(np.mean(one.by(way)[0][:, FOUND.index("stiffness")])) for one in specimens])
    return (
        f"the hinge is one, and its stiffness is {np.mean(k):.4g} N m/rad with "
        f"{100 * np.std(k, ddof=1) / np.mean(k):.2g} % (standard deviation) between bodies: more than mountings "
        "differ (2 to 3 %) would mean wrong mass properties"
    )


def _each_once(specimens: Sequence[Specimen]) -> bool:
    sizes = [tuple(one.sizes[name] for name in SIZES) for one in specimens]
    return len(set(sizes)) == len(sizes)


def _body(specimens: Sequence[Specimen], way: str, quantities: Sequence[Quantity]) -> list[str]:
    shifts = np.array([one.body.shift(*np.mean(one.by(way)[0], axis=0)) for one in specimens])
    if not np.any(shifts > 0):
        return []
    low, high = 100 * _NORMAL * shifts.min(axis=0), 100 * _NORMAL * shifts.max(axis=0)
    parts = [
        f"{quantity} by {_span(low[column], high[column])}"
        for column, quantity in enumerate(FOUND)
        if quantity in quantities
    ]
    return [
        "bodies are taken as the model states them. Their tolerances shift all specimens together, which is not in the "
        f"intervals: {' and '.join(parts)} (95 %)"
    ]


def _span(low: float, high: float) -> str:
    ends = f"{low:.2g}", f"{high:.2g}"
    return f"up to {ends[1]} %" if ends[0] == ends[1] else f"up to {ends[0]} to {ends[1]} %, by specimen"


def _listed(names: Sequence[str]) -> str:
    return str(names[0]) if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _capped(labels: Sequence[str]) -> str:
    return (
        _listed(labels)
        if len(labels) <= _SHOWN
        else f"{', '.join(labels[:_SHOWN])} and {len(labels) - _SHOWN} more"
    )
