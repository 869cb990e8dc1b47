"""The picture of a diagnosis: the verdict, where the gap is, and how far it closes."""

from pathlib import Path
from typing import Any

from labrun.gap.diagnosis import Diagnosis
from labrun.report.gap_canvas import plain_figure
from labrun.report.gap_how_far_figure import draw_how_far
from labrun.report.gap_places import panels
from labrun.report.gap_where_figure import WIDTH_IN, draw_where, height_in
from labrun.report.style import heading, save
from labrun.report.text import data_words, percent

FIGURE = "gap_figure.png"
_HOW_FAR_IN = 2.2
_HEADING_IN = 0.95
_MOST_PANELS = 4


def draw_gap(diagnosis: Diagnosis, path: Path) -> Path:
    """Draw where the gap is and how far it closes, under the verdict, and save it as PNG.

    Parameters
    ----------
    diagnosis
        What was found.
    path
        The file to write, whole or not at all.
    """
    shown = panels(diagnosis.where, _MOST_PANELS)
    where_in = height_in(shown) if shown else 0.0
    with plain_figure(WIDTH_IN, where_in + _HOW_FAR_IN + _HEADING_IN) as figure:
        heading(figure, f"{diagnosis.name} against the model {diagnosis.model}", _subtitle(diagnosis))
        if shown:
            parts: Any = figure.subfigures(2, 1, height_ratios=[where_in, _HOW_FAR_IN])
            draw_where(parts[0], shown)
            draw_how_far(parts[1].subplots(), diagnosis)
        else:
            draw_how_far(figure.subplots(), diagnosis)
        return save(figure, path)


def _subtitle(diagnosis: Diagnosis) -> str:
    told = diagnosis.sentence.rstrip()
    if diagnosis.causes:
        sure = ", ".join(percent(cause.confidence) for cause in diagnosis.causes)
        told += f" Confidence {sure}."
    return f"{told} From {data_words(diagnosis)}."
