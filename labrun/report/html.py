"""A run as one HTML file: for whoever comes back to the lab in the morning, read from the top down."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from labrun.report.figure import draw_view
from labrun.report.html_conditions import conditions_section
from labrun.report.html_elements import Html, paragraph, picture, section
from labrun.report.html_fits import fits_section
from labrun.report.html_gap import gap_section
from labrun.report.html_page import page
from labrun.report.html_provenance import provenance_section
from labrun.report.html_timing import timing_section
from labrun.report.html_trials import rejected_section
from labrun.report.html_trust import drift_section, repeatability_section, settling_section
from labrun.report.html_verdict import head
from labrun.report.report_source import ReportSource

Section = Callable[[ReportSource], Html | None]


def report_html(source: ReportSource) -> str:
    """Return the page; the same run gives the same text, byte for byte."""
    makers: list[tuple[str, str, Section]] = [
        ("result", "figure", _main_figure),
        ("conditions", "conditions", conditions_section),
        ("repeatability", "repeatability", repeatability_section),
        ("drift", "drift", drift_section),
        ("settling", "settling", settling_section),
        ("timing", "timing", timing_section),
        ("rejected", "rejected trials", rejected_section),
        ("fits", "fits", fits_section),
        ("gap", "gap", gap_section),
        ("provenance", "provenance", provenance_section),
    ]
    made = [(anchor, name, make(source)) for anchor, name, make in makers]
    sections = [(anchor, name, content) for anchor, name, content in made if content is not None]
    return page(f"{source.experiment.title} ({source.run.identifier})", head(source), sections)


def _main_figure(source: ReportSource) -> Html | None:
    if not source.accepted:
        return None
    try:
        data = source.figure.read_bytes() if source.figure is not None else _drawn(source)
    except Exception as error:  # a picture that cannot be drawn must not cost the numbers below it
        text = f"The figure could not be drawn: {type(error).__name__}: {error}"
        return section("result", "Result", paragraph(text, class_="stop"))
    alt = f"Result of {source.experiment.title}: the numbers it shows stand in the tables below"
    return section("result", "Result", picture(data, "png", alt=alt, class_="main"))


def _drawn(source: ReportSource) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figure.png"
        search = source.folder / "search" if source.folder is not None else None
        draw_view(source.view, search, path)
        return path.read_bytes()
