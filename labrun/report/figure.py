"""The picture of a run."""

from pathlib import Path

from labrun.report.data import RunView
from labrun.search.generation import read_generations
from labrun.search.result import Best
from labrun.spec.loading import loads_experiment
from labrun.store.reading import open_run

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
        experiment = loads_experiment(run.experiment_toml, run.name).experiment
        if not any(outcome.status == "done" for outcome in run.outcomes):
            return None
        view = RunView(run, experiment, best)
        path = folder / FIGURE
        generations = read_generations(folder / "search")
        if experiment.kind == "cmaes" and generations:
            from labrun.report.search_progress import draw_search

            return draw_search(view, generations, path)
        if experiment.kind == "sweep" and view.objective is not None:
            from labrun.report.sweep_map import draw_sweep

            return draw_sweep(view, path)
        from labrun.report.run_overlay import draw_plain_run

        return draw_plain_run(view, path)
