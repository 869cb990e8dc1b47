"""Fits that were made of a run, in its report."""

from collections.abc import Mapping
from typing import Any

from labrun.fit.estimate import Estimate, rounded
from labrun.report.html_elements import Content, Html, element, joined, paragraph, picture, section, table
from labrun.report.report_source import ReportSource
from labrun.report.stored_fits import StoredFit, as_list, as_table, is_number, stored_fits
from labrun.report.text import spaced

_SHOWN_ELSEWHERE = frozenset(
    {
        "parameters", "rmse", "figure", "warnings", "model", "method", "source", "fixed", "findings", "tables",
        "by_trial",
    }
)  # fmt: skip
_DEEPEST = 2
_MOST_ITEMS = 8


def fits_section(source: ReportSource) -> Html | None:
    """Return every fit in the run's folder; None if there is none."""
    fits = [_fit(fit) for fit in stored_fits(source.folder)]
    return section("fits", "Fits" if len(fits) > 1 else "Fit", *fits) if fits else None


def _fit(fit: StoredFit) -> Html:
    if fit.fault:
        text = f"{fit.path.name} cannot be read ({fit.fault}): labrun fit writes it anew."
        return paragraph(text, class_="stop")
    return joined(
        [
            element("h3", f"Model {fit.title}"),
            *(paragraph(warning, class_="stop") for warning in fit.sentences("warnings")),
            *(paragraph(finding) for finding in fit.sentences("findings")),
            _parameters(fit.numbers),
            *(_table_of(entry) for entry in as_list(fit.numbers.get("tables"))),
            _rest(fit.numbers),
            _figure(fit),
        ]
    )


def _parameters(numbers: Mapping[str, Any]) -> Html:
    rows: list[list[Content]] = []
    for name, entry in numbers["parameters"].items():
        rows.append([spaced(str(name)), *_estimate(entry)])
    rows += [
        [spaced(str(name)), _short(value), "as given", ""]
        for name, value in as_table(numbers.get("fixed")).items()
    ]
    return table(("parameter", "value", "95 % interval", "unit"), rows, words=(0, 3))


def _estimate(entry: Any) -> tuple[str, str, str]:
    if not isinstance(entry, Mapping):
        return _short(entry), "", ""
    value: Any = entry.get("value")
    unit, interval = str(entry.get("unit", "")), as_list(entry.get("ci95"))
    if not is_number(value) or len(interval) != 2 or not all(is_number(end) for end in interval):
        return _short(value), "not known", unit
    middle, low, high = rounded(Estimate(float(value), (float(interval[0]), float(interval[1])), unit))
    return middle, f"{low} to {high}", unit


def _table_of(entry: Any) -> Html | None:
    """Return a table that a method has stored as it prints it."""
    known = as_table(entry)
    header = tuple(str(one) for one in as_list(known.get("header")))
    rows = [[str(cell) for cell in row] for row in as_list(known.get("rows")) if isinstance(row, list)]
    whole = [row for row in rows if len(row) == len(header)]
    return table(header, whole, caption=str(known.get("title", ""))) if header and whole else None


def _rest(numbers: Mapping[str, Any]) -> Html | None:
    """Return the errors of the fit, and whatever else a method has written down, as a table."""
    rows: list[list[Content]] = [
        [f"rms of measured - simulated, {spaced(str(name))}", _short(value)]
        for name, value in as_table(numbers.get("rmse")).items()
    ]
    for name, value in numbers.items():
        if name not in _SHOWN_ELSEWHERE:
            rows += _entries(spaced(str(name)), value, 1)
    return table(("", ""), rows) if rows else None


def _entries(name: str, value: Any, depth: int) -> list[list[Content]]:
    if isinstance(value, Mapping):
        if depth > _DEEPEST:
            return []
        return [
            row
            for key, item in value.items()
            for row in _entries(f"{name}, {spaced(str(key))}", item, depth + 1)
        ]
    if isinstance(value, list):
        plain = len(value) <= _MOST_ITEMS and not any(isinstance(item, dict | list) for item in value)
        return [[name, ", ".join(_short(item) for item in value)]] if plain else []
    return [[name, _short(value)]]


def _figure(fit: StoredFit) -> Html | None:
    if fit.figure is None:
        return None
    alt = f"Measured and simulated signals of the fit of {fit.model}, and residuals"
    return picture(fit.figure.read_bytes(), "png", alt=alt)


def _short(value: Any) -> str:
    if is_number(value):
        return f"{value:.5g}"
    return "not known" if value is None else str(value)
