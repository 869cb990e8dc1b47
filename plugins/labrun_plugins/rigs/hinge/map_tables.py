"""What a person compares: specimens beside both maps, how good the maps are, and their coefficients."""

from collections.abc import Sequence

import numpy as np

from labrun.fit import Estimate, TextTable, rounded
from labrun_plugins.rigs.hinge.polynomial import FittedMap
from labrun_plugins.rigs.hinge.published import PUBLISHED, UNITS
from labrun_plugins.rigs.hinge.specimens import Specimen

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
