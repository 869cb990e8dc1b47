"""Fits that were made of a run: what stands in its folder ``fit``."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labrun.fit.estimate import Estimate, rounded
from labrun.report.html_elements import Content, Html, element, joined, paragraph, picture, section, table
from labrun.report.html_words import spaced
from labrun.report.report_source import ReportSource

FITS = "fit"
_KNOWN = frozenset({"parameters", "rmse", "figure", "warnings", "model", "method", "source", "fixed"})
_DEEPEST = 2


def fits_section(source: ReportSource) -> Html | None:
    """Return every fit in the run's folder; None if there is none."""
    fits = [fit for path in fit_files(source) if (fit := _fit(path)) is not None]
    return section("fits", "Fits" if len(fits) > 1 else "Fit", *fits) if fits else None


def fit_files(source: ReportSource) -> list[Path]:
    """Return the files of the fits that were made of a run."""
    return [] if source.folder is None else sorted((source.folder / FITS).glob("*.json"))


def _fit(path: Path) -> Html | None:
    try:
        numbers = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        return paragraph(f"{path.name} cannot be read ({error}): labrun fit writes it anew.", class_="stop")
    if not isinstance(numbers, dict) or not isinstance(numbers.get("parameters"), dict):
        return None
    model, method = str(numbers.get("model", path.stem)), str(numbers.get("method", ""))
    by = f", by {method}" if method and method != model else ""
    return joined(
        [
            element("h3", f"Model {model}{by}"),
            *(paragraph(str(warning), class_="stop") for warning in _list(numbers.get("warnings"))),
            _parameters(numbers),
            _rest(numbers),
            _figure(path, model),
        ]
    )


def _parameters(numbers: Mapping[str, Any]) -> Html:
    rows: list[list[Content]] = []
    for name, entry in numbers["parameters"].items():
        rows.append([spaced(str(name)), *_estimate(entry)])
    rows += [
        [spaced(str(name)), _short(value), "as given", ""]
        for name, value in _table(numbers.get("fixed")).items()
    ]
    return table(("parameter", "value", "95 % interval", "unit"), rows, words=(0, 3))


def _estimate(entry: Any) -> tuple[str, str, str]:
    if not isinstance(entry, Mapping):
        return _short(entry), "", ""
    value: Any = entry.get("value")
    unit, interval = str(entry.get("unit", "")), _list(entry.get("ci95"))
    if not _is_number(value) or len(interval) != 2 or not all(_is_number(end) for end in interval):
        return _short(value), "not known", unit
    middle, low, high = rounded(Estimate(float(value), (float(interval[0]), float(interval[1])), unit))
    return middle, f"{low} to {high}", unit


def _rest(numbers: Mapping[str, Any]) -> Html | None:
    """Return the errors of the fit, and whatever else a method has written down, as a table."""
    rows: list[list[Content]] = [
        [f"rms of measured - simulated, {spaced(str(name))}", _short(value)]
        for name, value in _table(numbers.get("rmse")).items()
    ]
    for name, value in numbers.items():
        if name not in _KNOWN:
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
        return [[name, ", ".join(_short(item) for item in value)]] if len(value) <= 8 and not any(
            isinstance(item, dict | list) for item in value
        ) else []  # fmt: skip
    return [[name, _short(value)]]


def _figure(path: Path, model: str) -> Html | None:
    drawn = path.with_suffix(".png")
    if not drawn.is_file():
        return None
    return picture(
        drawn.read_bytes(), "png", alt=f"Measured and simulated signals of the fit of {model}, and residuals"
    )


def _short(value: Any) -> str:
    if _is_number(value):
        return f"{value:.5g}"
    return "not known" if value is None else str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _table(value: Any) -> dict[Any, Any]:
    return value if isinstance(value, dict) else {}
