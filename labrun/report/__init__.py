"""What people read of results: tables and live displays in the terminal, pages, figures. It starts nothing.

What needs matplotlib, a diagnosis or a fit is loaded when it is asked for: whoever shows text alone does without them.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from labrun import UseCasePackage
from labrun.report.conditions import candidate_points
from labrun.report.data import RunView, experiment_of
from labrun.report.findings import Findings, StoredFit, StoredGap
from labrun.report.live import LiveProgress, PlainProgress, Snapshot, State, event_text, render, watch
from labrun.report.statistics import DRIFT_SUFFIX, Drift, drift_of, without_drift
from labrun.report.terminal import keys_text, plan_text, print_findings, remark_text
from labrun.report.text import aligned, counted, duration_text, interval_text, short_time_text

if TYPE_CHECKING:
    from labrun.report.comparison import (
        comparison_figure,
        comparison_json,
        comparison_text,
        ranking_text,
    )
    from labrun.report.diagnosis_check import check_text, write_check_page
    from labrun.report.figures import run_figure
    from labrun.report.figures.design import draw_design
    from labrun.report.figures.fits import draw_figure, fit_figure
    from labrun.report.figures.gap import diagnosis_figure
    from labrun.report.gap_page import diagnosis_page
    from labrun.report.gap_text import compared_text, fresh_text, gap_lines, trial_plan_text, units_text
    from labrun.report.robot import file_check_lines, other_fit_lines, robot_figure, robot_lines, robot_page
    from labrun.report.run_page import report_page
    from labrun.report.style import as_svg, save_figure

_LATER = {
    "comparison": ("comparison_figure", "comparison_json", "comparison_text", "ranking_text"),
    "diagnosis_check": ("check_text", "write_check_page"),
    "figures": ("run_figure",),
    "figures.design": ("draw_design",),
    "figures.fits": ("draw_figure", "fit_figure"),
    "figures.gap": ("diagnosis_figure",),
    "gap_page": ("diagnosis_page",),
    "gap_text": ("compared_text", "fresh_text", "gap_lines", "trial_plan_text", "units_text"),
    "robot": ("file_check_lines", "other_fit_lines", "robot_figure", "robot_lines", "robot_page"),
    "run_page": ("report_page",),
    "style": ("as_svg", "save_figure"),
}
"""Modules that are loaded when one of their names is asked for."""

__all__ = [
    "DRIFT_SUFFIX",
    "Drift",
    "Findings",
    "LiveProgress",
    "PlainProgress",
    "RunView",
    "Snapshot",
    "State",
    "StoredFit",
    "StoredGap",
    "aligned",
    "as_svg",
    "candidate_points",
    "check_text",
    "compared_text",
    "comparison_figure",
    "comparison_json",
    "comparison_text",
    "counted",
    "diagnosis_figure",
    "diagnosis_page",
    "draw_design",
    "draw_figure",
    "drift_of",
    "duration_text",
    "event_text",
    "experiment_of",
    "file_check_lines",
    "fit_figure",
    "fresh_text",
    "gap_lines",
    "interval_text",
    "keys_text",
    "other_fit_lines", "plan_text",
    "print_findings",
    "ranking_text",
    "remark_text",
    "render",
    "report_page",
    "robot_figure",
    "robot_lines",
    "robot_page",
    "run_figure",
    "save_figure",
    "short_time_text",
    "trial_plan_text",
    "units_text",
    "watch",
    "without_drift",
    "write_check_page",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Return a name from a lazily loaded module."""
    for module, names in _LATER.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


sys.modules[__name__].__class__ = UseCasePackage
