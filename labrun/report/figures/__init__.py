"""Figures of runs, fits and diagnoses: functions that return a matplotlib figure, one module for each kind."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from labrun.report.data import RunView
from labrun.report.figures.runs import MOST_TRACED, draw_plain_run
from labrun.report.figures.search import draw_search
from labrun.report.figures.sweep import draw_sweep
from labrun.report.figures.track import draw_track

__all__ = ["run_figure"]


def run_figure(view: RunView, generations: Sequence[Mapping[str, Any]] = ()) -> Figure | None:
    """Plot a run according to its kind; return None without an accepted trial or anything to plot.

    Parameters
    ----------
    view
        The run.
    generations
        Of its search, if it has one.
    """
    if not any(outcome.status == "done" for outcome in view.run.outcomes):
        return None
    if view.experiment.search is not None and generations:
        return draw_search(view, generations)
    if view.experiment.kind == "sweep" and view.objective is not None and not _few(view):
        return draw_sweep(view)
    if view.experiment.kind == "track":
        return draw_track(view)
    return draw_plain_run(view)


def _few(view: RunView) -> bool:
    """Tell whether a sweep of several parameters without a goal has so few conditions that each is worth its trace."""
    conditions = [trials[0].condition for trials in view.accepted_trials.values()]
    varied = {
        name
        for condition in conditions
        for name in condition
        if any(condition[name] != other[name] for other in conditions)
    }
    return view.experiment.goal is None and len(varied) > 1 and len(conditions) <= MOST_TRACED
