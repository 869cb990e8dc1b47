"""A run as one HTML file: for whoever comes back to the lab in the morning, read from the top down."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from labrun.errors import StoreError
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
from labrun.report.report_source import ReportSource, read_source
from labrun.store.reading import Run

REPORT = "report.html"

Section = Callable[[ReportSource], Html | None]


def write_report(run: Run, output: Path | None = None) -> Path:
    """Write a run's report.

    Parameters
    ----------
    run
        Open for reading; finished or not, measured or imported.
    output
        The file. Else ``report.html`` in the run's folder; of a ``run.h5`` that stands alone, ``<name>-report.html``
        beside it.

    Returns
    -------
    Path
        The file, which holds everything it shows and loads nothing.

    Raises
    ------
    StoreError
        The file cannot be written.
    SpecError
        The stored experiment file does not hold.
    """
    source = read_source(run)
    path = output if output is not None else _beside(source)
    text = report_html(source)
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise StoreError(
            f"{path} cannot be written: {error.strerror}", hint="--output FILE writes elsewhere"
        ) from error
    return path


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


def _beside(source: ReportSource) -> Path:
    if source.folder is not None:
        return source.folder / REPORT
    return source.run.path.with_name(f"{source.run.path.stem}-{REPORT}")


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
