"""A diagnosis as one HTML file: read from the top down, offline, on a screen and on paper."""

from pathlib import Path

from labrun.errors import StoreError
from labrun.gap.diagnosis import Diagnosis
from labrun.report.gap_candidates import candidates_section
from labrun.report.gap_details import data_section, limits_section, origin_section, recalibration_section
from labrun.report.gap_head import gap_head
from labrun.report.gap_sections import how_far_section, next_section, where_section
from labrun.report.html_page import page

PAGE = "gap.html"


def write_gap_page(diagnosis: Diagnosis, folder: Path) -> Path:
    """Write the page of a diagnosis.

    Parameters
    ----------
    diagnosis
        What was found.
    folder
        Made if it is not there.

    Returns
    -------
    Path
        ``gap.html`` in it, which holds everything it shows and loads nothing.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    path = folder / PAGE
    text = gap_html(diagnosis)
    partial = path.with_name(f".{path.name}.partial")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {error.strerror}") from error
    return path


def gap_html(diagnosis: Diagnosis) -> str:
    """Return the page; the same diagnosis gives the same text, byte for byte."""
    makers = [
        ("where", "where", where_section),
        ("which", "which cause", candidates_section),
        ("far", "how far", how_far_section),
        ("next", "what next", next_section),
        ("limits", "limitations", limits_section),
        ("recalibration", "parameters", recalibration_section),
        ("data", "data and noise", data_section),
        ("origin", "origin", origin_section),
    ]
    made = [(anchor, name, make(diagnosis)) for anchor, name, make in makers]
    sections = [(anchor, name, content) for anchor, name, content in made if content is not None]
    return page(f"{diagnosis.name} against {diagnosis.model}", gap_head(diagnosis), sections)
