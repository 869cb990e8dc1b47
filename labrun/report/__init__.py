"""What people read of results: tables and live displays in the terminal, pages, figures. It starts nothing.

Figures are in `labrun.report.figures`, pages in `labrun.report.run_page` and `labrun.report.gap_page`: they load
matplotlib, so whoever shows text alone does without them.
"""

import sys

from labrun import UseCasePackage
from labrun.report.data import RunView, experiment_of
from labrun.report.findings import Findings, StoredFit, StoredGap
from labrun.report.live import LiveProgress, PlainProgress, Snapshot, State, event_text, render, watch
from labrun.report.statistics import Drift, drift_of, without_drift
from labrun.report.terminal import keys_text, plan_text, print_findings, remark_text
from labrun.report.text import duration_text, interval_text

__all__ = [
    "Drift", "Findings", "LiveProgress", "PlainProgress",
    "RunView", "Snapshot", "State", "StoredFit", "StoredGap", "drift_of", "duration_text", "event_text",
    "experiment_of", "interval_text", "keys_text", "plan_text", "print_findings",
    "remark_text", "render", "watch", "without_drift",
]  # fmt: skip

sys.modules[__name__].__class__ = UseCasePackage
