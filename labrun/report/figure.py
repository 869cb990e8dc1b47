"""The picture of a run."""

from pathlib import Path

from labrun.report.data import RunView
from labrun.report.recorded import experiment_of
from labrun.search.generation import read_generations
from labrun.search.result import Best
from labrun.store import open_run

FIGURE = "figure.png"


def draw_run(folder: Path, best: Best | None) -> Path | None:
    """Draw a run as its kind asks for, into its folder.

    Parameters
    ----------
    folder
        The run's folder.
    best
        Its honest best.

    Returns
    -------
    Path or None
        The picture, ``figure.png``; None if no trial was accepted, so that there is nothing to draw.
    """
    with open_run(folder) as run:
        if not any(outcome.status == "done" for outcome in run.outcomes):
            return None
        view = RunView(run, experiment_of(run.experiment_toml, run.name), best)
        return draw_view(view, folder / "search", folder / FIGURE)


def draw_view(view: RunView, search: Path | None, path: Path) -> Path:
    """Draw a run that has accepted trials, as its kind asks for.

    Parameters
    ----------
    view
        The run.
    search
        Folder of its generations, if it has one.
    path
        Where the picture goes.
    """
    generations = read_generations(search) if search is not None else []
    if view.experiment.kind == "cmaes" and generations:
        from labrun.report.search_progress import draw_search

        return draw_search(view, generations, path)
    if view.experiment.kind == "sweep" and view.objective is not None:
        from labrun.report.sweep_map import draw_sweep

        return draw_sweep(view, path)
    if view.experiment.kind == "track":
        from labrun.report.track_figure import draw_track

        return draw_track(view, path)
    from labrun.report.run_overlay import draw_plain_run

    return draw_plain_run(view, path)
