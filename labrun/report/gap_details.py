"""The details of a diagnosis: recalibration, noise, what it cannot say, and where it comes from."""

import math
from collections.abc import Sequence

from labrun.gap.diagnosis import Diagnosis
from labrun.report.html_elements import Content, Html, element, paragraph, section, table
from labrun.report.text import data_words, number, scatter_text, short_time_text, spaced

_FAR = 3.0
"""Of more than so many stated tolerances a parameter is not just recalibrated, it was wrong."""


def limits_section(diagnosis: Diagnosis) -> Html | None:
    """Return what these data do not allow to say; None if nothing."""
    if not diagnosis.limitations:
        return None
    return section("limits", "What these data do not tell", _list(diagnosis.limitations))


def recalibration_section(diagnosis: Diagnosis) -> Html | None:
    """Return the parameters as stated and as recalibrated; None of a model without any that may move."""
    rows: list[list[Content]] = []
    marked = []
    for name, (stated, tolerance, found) in diagnosis.recalibration.items():
        told, far = _moved(stated, tolerance, found)
        if far:
            marked.append(len(rows))
        unit = diagnosis.parameter_units.get(name, "")
        rows.append(
            [
                spaced(name),
                number(stated, 4),
                _tolerance(tolerance),
                number(found, 4),
                number(diagnosis.corrected[name], 4) if name in diagnosis.corrected else "",
                "" if unit == "1" else unit,
                told,
            ]
        )
    if not rows:
        return None
    columns = ("parameter", "stated", "known to", "recalibrated", "with the causes", "unit", "moved by")
    return section(
        "recalibration",
        "Parameters",
        table(columns, rows, words=(0, 5, 6), marked=marked),
        paragraph(
            "Recalibrated: the best fit without any effect added, held by how well each parameter is known beforehand. "
            "With the causes: fitted together with them; these stand in the corrected model.",
            class_="note",
        ),
    )


def _tolerance(tolerance: float | str) -> str:
    if isinstance(tolerance, str):
        return "not known" if tolerance == "free" else tolerance
    return "exactly" if tolerance == 0 else f"\u00b1 {100 * tolerance:.3g} %"


def _moved(stated: float, tolerance: float | str, found: float) -> tuple[str, bool]:
    """Return by how much a parameter moved, and whether that is farther than its tolerance makes likely."""
    if stated == 0 or not math.isfinite(found / stated):
        return (f"by {number(found - stated)}" if found != stated else "not at all"), False
    factor = found / stated
    if factor == 1:
        return "not at all", False
    text = (
        f"{number(factor)} times the stated" if factor > 2 or factor < 0.5 else f"{100 * (factor - 1):+.2g} %"
    )
    if isinstance(tolerance, str) or tolerance == 0:
        return text, False
    steps = abs(factor - 1) / tolerance
    return f"{text}, {number(steps, 2)} of its tolerances", steps >= _FAR


def data_section(diagnosis: Diagnosis) -> Html:
    """Return how much noise there is in which channel, and what the data are."""
    units = dict(diagnosis.channels)
    rows: list[list[Content]] = [
        [spaced(name), scatter_text(sd, "" if units.get(name, "1") == "1" else units[name])]
        for name, sd in diagnosis.noise.items()
    ]
    inputs = ", ".join(_channel(name, unit) for name, unit in diagnosis.input_channels)
    return section(
        "data",
        "Data and noise",
        paragraph(f"{data_words(diagnosis)}. Inputs: {inputs or 'none'}."),
        table(("output", "noise of one trial (sd)"), rows) if rows else None,
        _list(diagnosis.notes) if diagnosis.notes else None,
    )


def origin_section(diagnosis: Diagnosis) -> Html:
    """Return where the numbers come from, so that they can be had again."""
    rows: list[list[Content]] = [
        ["data", element("code", diagnosis.source)],
        ["model", diagnosis.model],
        ["guard against false alarms", diagnosis.guard],
        ["seed", str(diagnosis.seed)],
        ["computing took", short_time_text(diagnosis.seconds)],
    ]
    return section("origin", "Where this comes from", table(("", ""), rows, words=(0, 1)))


def _channel(name: str, unit: str) -> str:
    return spaced(name) if unit in ("1", "") else f"{spaced(name)} ({unit})"


def _list(sentences: Sequence[str]) -> Html:
    return element("ul", *(element("li", text) for text in sentences))
