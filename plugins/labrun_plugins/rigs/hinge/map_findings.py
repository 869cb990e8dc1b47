"""What the maps show, and what to know before trusting them."""

import itertools
from collections.abc import Sequence

import numpy as np

from labrun.fit import FEW_TRIALS
from labrun_plugins.rigs.hinge.body import FOUND
from labrun_plugins.rigs.hinge.polynomial import FittedMap
from labrun_plugins.rigs.hinge.published import PUBLISHED, UNITS, Quantity
from labrun_plugins.rigs.hinge.specimens import SIZES, Specimen

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
