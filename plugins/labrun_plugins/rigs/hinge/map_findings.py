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


def specimen_table(fitted_map: FittedMap, specimens: Sequence[Specimen], way: str) -> TextTable:
    """Return one row a specimen: measured with interval, the fitted map, the published map."""
    published = [fitted_map.form.published_value(specimen.sizes) for specimen in specimens]
    rows = []
    for specimen, measured, fitted, other in zip(
        specimens, fitted_map.measured, fitted_map.fitted, published, strict=True
    ):
        estimate = specimen.by(way)[1][fitted_map.form.quantity]
        value, low, high = rounded(estimate)
        rows.append(
            (
                specimen.label, str(len(specimen.values)), value, f"{low} ... {high}",
                f"{fitted:.3e}", f"{100 * (measured / fitted - 1):+.1f} %",
                f"{other:.3e}" if np.isfinite(other) else NONE,
                f"{100 * (measured / other - 1):+.1f} %" if np.isfinite(other) and other > 0 else NONE,
            )
        )  # fmt: skip
    number = fitted_map.form.published.equation if fitted_map.form.published is not None else "published"
    symbol, unit = fitted_map.form.symbol, UNITS[fitted_map.form.quantity]
    header = ("specimen", "releases", symbol, "95 % interval", "map", "off it", number, "off it")
    return TextTable(f"{symbol} of every specimen, {unit}", header, tuple(rows))


def quality_table(maps: Sequence[FittedMap]) -> TextTable:
    """Return one row a map: its errors beside those the source printed for (3.11) and (3.12), and its conditioning."""
    rows = []
    for fitted in maps:
        own = next(
            known
            for (quantity, _), known in PUBLISHED.items()
            if quantity == fitted.form.quantity and known.mae
        )
        rows.append(
            (
                fitted.form.label, str(len(fitted.measured)), str(len(fitted.form.terms)), f"{fitted.mae:.2e}",
                _percent(fitted.percent(fitted.mae)), _percent(fitted.percent(fitted.left_out_mae)),
                f"{own.mae:.2e}", f"{_percent(own.mae_percent)} {own.equation}",
                f"{fitted.condition:.3g}", f"{fitted.raw_condition:.2g}",
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


def coefficient_table(fitted: FittedMap) -> TextTable:
    """Return the coefficients with both intervals, beside the published ones."""
    published = {} if fitted.form.published is None else fitted.form.published.coefficients
    rows = []
    for index, (name, term) in enumerate(zip(fitted.form.names, fitted.form.terms, strict=True)):
        value = float(fitted.coefficients[index])
        rows.append(
            (
                name,
                NONE if fitted.undetermined[index] else f"{value:.4g}",
                NONE if fitted.undetermined[index] else _interval(value, fitted.by_releases[index]),
                NONE if fitted.undetermined[index] else _interval(value, fitted.by_scatter[index]),
                f"{published[term]:.5g}" if term in published else NONE,
            )
        )
    number = fitted.form.published.equation if fitted.form.published is not None else "published"
    header = ("coefficient", "value", "95 %, releases alone", "95 %, scatter of specimens", number)
    return TextTable(f"{fitted.form.label}: where its intervals come from", header, tuple(rows))


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
    for fitted in maps:
        names = [name for name in ("w", "l", "a") if name in fitted.form.variables]
        rows.append(tuple(_stack(fitted, name, specimens, way) for name in names))
    errors = ", ".join(f"{fitted.form.label} MAE {fitted.percent(fitted.mae):.2g} %" for fitted in maps)
    return FigureData(f"Hinges over their sizes\n{errors}", tuple(rows), legend="top", row_height_in=3.8)


def _stack(fitted_map: FittedMap, name: str, specimens: Sequence[Specimen], way: str) -> Stack:
    scale, unit = _SCALES[fitted_map.form.quantity]
    size = 1.0 / SIZES[name][1]
    points = fitted_map.line(name)
    low, high = fitted_map.band(points)
    published = _published(fitted_map, name, points, specimens)
    on_line = np.array([_on_line(fitted_map, name, index) for index in range(len(specimens))])
    at = size * fitted_map.sizes[name][on_line]
    measured, fitted = fitted_map.measured[on_line], fitted_map.fitted[on_line]
    ends = np.array([specimen.by(way)[1][fitted_map.form.quantity].ci95 for specimen in specimens])[on_line]
    curves = [
        Curve(
            size * points[name], scale * fitted_map.value(points), "fitted", "fitted map, 95 % band", "band",
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
    values = scale * np.concatenate(
        [ends.ravel(), fitted_map.value(points), published[np.isfinite(published)]]
    )
    room = 0.12 * float(np.ptp(values))
    off, bars = 100.0 * (measured / fitted - 1.0), [100.0 * (ends[:, side] / fitted - 1.0) for side in (0, 1)]
    limit = 1.25 * max(float(np.max(np.abs([off, *bars]))), 0.1)
    others = [
        f"{other} = {value / SIZES[other][1]:g} {_AXES[other].rpartition(', ')[2]}"
        for other, value in fitted_map.crossing.items()
        if other != name
    ]
    upper = Panel(
        tuple(curves),
        title=f"{fitted_map.form.symbol} over {name}" + (f" at {', '.join(others)}" if others else ""),
        y_label=f"{fitted_map.form.quantity} {fitted_map.form.symbol}, {unit}",
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
    fitted: FittedMap, name: str, points: dict[str, FloatArray], specimens: Sequence[Specimen]
) -> FloatArray:
    """Return the published map along a line, nan where it may not be read."""
    values = np.full(len(points[name]), np.nan)
    readable = any(np.isfinite(fitted.form.published_value(specimen.sizes)) for specimen in specimens)
    if fitted.form.published is not None and readable:
        low, high = PUBLISHED_RANGE[name]
        for index in np.flatnonzero((points[name] >= low) & (points[name] <= high)):
            values[index] = fitted.form.published.value({other: at[index] for other, at in points.items()})
    return values


def _on_line(fitted: FittedMap, name: str, index: int) -> bool:
    return all(
        abs(fitted.sizes[other][index] / value - 1) <= _ALIKE
        for other, value in fitted.crossing.items()
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
    notes = []
    for fitted in maps:
        known = _published_mae(fitted, specimens)
        if fitted.form.published is not None and np.isfinite(known):
            notes.append(
                f"on these specimens the published map {fitted.form.published.equation} has a mean absolute error of "
                f"{known:.2e} {UNITS[fitted.form.quantity]} ({fitted.percent(known):.1f} % of the mean)"
                f"{_comprehensive(fitted, specimens)}; {fitted.form.label} as fitted {fitted.percent(fitted.mae):.1f} %"
            )
    notes += [
        _scatter(fitted)
        for fitted in maps
        if np.isfinite(fitted.scatter) and np.isfinite(fitted.release_scatter)
    ]
    if all(fitted.form.quantity != "stiffness" for fitted in maps):
        notes.append(_one_stiffness(specimens, way))
    apart = [
        (fitted, float(np.max(np.abs(fitted.measured / two.measured - 1.0))))
        for fitted, two in zip(maps, other, strict=True)
    ]
    notes.append(
        "Fourier derivatives and simulation differ by at most "
        + " and ".join(f"{100 * size:.2g} % in {name.form.symbol}" for name, size in apart)
        + " of a specimen"
    )
    return notes


def map_warnings(fitted: FittedMap) -> list[str]:
    """Return what a map's coefficients cannot be trusted for."""
    label, notes = fitted.form.label, []
    names = np.array(fitted.form.names)
    open_ = names[fitted.undetermined].tolist()
    if len(open_):
        notes.append(
            f"{label}: the specimens do not determine {_listed(open_)}; they are left out of the estimates. Only a "
            "combination of them is known: vary one size while the others stay, at three sizes or more"
        )
    elif fitted.condition > _NEARLY_COLLINEAR:
        notes.append(
            f"{label}: the regressors are nearly collinear (condition number {fitted.condition:.2g}, centred "
            "and scaled): "
            "coefficients trade against one another, and only the map's values between the specimens mean something"
        )
    if fitted.freedom == 0:
        notes.append(
            f"{label}: {len(fitted.measured)} specimens for {len(fitted.form.terms)} coefficients: the map "
            "goes through all "
            "of them, nothing is left to judge it by, and the intervals know of releases only"
        )
    elif fitted.freedom < _FEW_FREEDOMS:
        notes.append(
            f"{label}: {len(fitted.measured)} specimens for {len(fitted.form.terms)} coefficients leave "
            f"{fitted.freedom} degree{'s' * (fitted.freedom != 1)} of freedom: intervals are wide, and the error of "
            "specimens it was fitted to flatters the map; leave one out tells more"
        )
    zero = [
        name
        for name, estimate in fitted.estimates.items()
        if estimate.contains_zero and not name.endswith("_0")
    ]
    if len(zero) == 1:
        notes.append(f"{label}: {zero[0]} is not distinguishable from zero: these specimens do not need it")
    elif zero:
        notes.append(
            f"{label}: {_listed(zero)} are not distinguishable from zero separately: the specimens do not "
            "determine the share of each"
        )
    straight = [name for name in fitted.form.variables if (name, 2) not in fitted.form.terms]
    if straight:
        notes.append(
            f"{label}: two sizes of {_listed(straight)} only: a straight line, where the source has a parabola"
        )
    if fitted.form.published is None:
        notes.append(f"{label}: the source has no map over just these sizes to compare with")
    return [*notes, *_negative(fitted)]


def warnings(maps: Sequence[FittedMap], specimens: Sequence[Specimen], way: str) -> list[str]:
    """Return what concerns all maps."""
    notes = []
    for fitted in maps:
        labels = [
            one_.label for one_ in specimens if not np.isfinite(fitted.form.published_value(one_.sizes))
        ]
        if labels and fitted.form.published is not None:
            notes.append(
                f"{fitted.form.published.equation} is not compared with {_capped(labels)}: the specimen is "
                "outside of the "
                "sizes it was fitted to, or not nominal otherwise (50 mm wide, 1.75 mm long, 43 cm^2)"
            )
    few = [specimen.label for specimen in specimens if len(specimen.values) < FEW_TRIALS]
    if few:
        notes.append(
            f"fewer than {FEW_TRIALS} releases of {_capped(few)}: intervals of these specimens are coarse"
        )
    if _each_once(specimens):
        notes.append(
            "every specimen was mounted once: what a mounting changes (2 to 3 % in the source's repeats) is in the "
            "scatter about the map, and cannot be separated from the effect of a dimension; add a run (--with RUN)"
        )
    notes += _body(specimens, way, [fitted.form.quantity for fitted in maps])
    own = [f"{specimen.label}: {text}" for specimen in specimens for text in specimen.warnings]
    notes += own[:_SHOWN]
    if len(own) > _SHOWN:
        notes.append(f"more on single specimens ({len(own) - _SHOWN}) is stored with the fit")
    return notes


def _published_mae(fitted: FittedMap, specimens: Sequence[Specimen]) -> float:
    """Return the mean absolute error of the published map on these specimens; nan if it may be read at none."""
    published = np.array([fitted.form.published_value(specimen.sizes) for specimen in specimens])
    error = np.abs(fitted.measured - published)
    return float(np.nanmean(error)) if np.isfinite(error).any() else float("nan")


def _negative(fitted: FittedMap) -> list[str]:
    """Return where along the lines of specimens the map is negative, and in how much of the box around them."""
    notes = []
    for name in fitted.form.variables:
        points = fitted.line(name)
        values = fitted.value(points)
        below = points[name][values <= 0]
        if len(below):
            condition, factor = SIZES[name]
            unit = condition.rpartition("_")[2].replace("cm2", "cm^2")
            notes.append(
                f"{fitted.form.label} turns negative between specimens, at {name} = {below[0] / factor:.3g} to "
                f"{below[-1] / factor:.3g} {unit} (least: {values.min():.2g} {UNITS[fitted.form.quantity]}): do "
                "not use "
                "it there, and measure a specimen there"
            )
    if len(fitted.form.variables) > 1:
        axes = [np.linspace(values.min(), values.max(), _BOX) for values in fitted.sizes.values()]
        grid = np.array(list(itertools.product(*axes))).T
        share = float(np.mean(fitted.value(dict(zip(fitted.sizes, grid, strict=True))) <= 0))
        if share > 0:
            notes.append(
                f"{fitted.form.label} is negative in {100 * share:.2g} % of the box that the specimens span, off the "
                "lines along which they were varied: nothing was measured there, and the map says nothing about it"
            )
    return notes


def _scatter(fitted: FittedMap) -> str:
    size, releases = fitted.percent(fitted.scatter), fitted.percent(fitted.release_scatter)
    text = (
        f"specimens lie {size:.2g} % (standard deviation) off {fitted.form.label}; releases of a specimen account for "
        f"{releases:.2g} %"
    )
    if size > _ABOVE_RELEASES * releases:
        text += ": the rest is how specimens are made and mounted, or a shape the polynomial lacks"
    return text


def _comprehensive(fitted: FittedMap, specimens: Sequence[Specimen]) -> str:
    """Tell what the source's map over all sizes makes of the specimens: its maps do not agree with one another."""
    whole = next(
        known for (quantity, _), known in PUBLISHED.items() if quantity == fitted.form.quantity and known.mae
    )
    if whole is fitted.form.published:
        return ""
    error = np.mean(
        [abs(y - whole.value(at.sizes)) for y, at in zip(fitted.measured, specimens, strict=True)]
    )
    return f", its {whole.equation} over all sizes {fitted.percent(float(error)):.1f} %"


def _one_stiffness(specimens: Sequence[Specimen], way: str) -> str:
    k = np.array([float(np.mean(specimen.by(way)[0][:, FOUND.index("stiffness")])) for specimen in specimens])
    return (
        f"the hinge is one, and its stiffness is {np.mean(k):.4g} N m/rad with "
        f"{100 * np.std(k, ddof=1) / np.mean(k):.2g} % (standard deviation) between bodies: more than mountings "
        "differ (2 to 3 %) would mean wrong mass properties"
    )


def _each_once(specimens: Sequence[Specimen]) -> bool:
    sizes = [tuple(specimen.sizes[name] for name in SIZES) for specimen in specimens]
    return len(set(sizes)) == len(sizes)


def _body(specimens: Sequence[Specimen], way: str, quantities: Sequence[Quantity]) -> list[str]:
    shifts = np.array([specimen.body.shift(*np.mean(specimen.by(way)[0], axis=0)) for specimen in specimens])
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
