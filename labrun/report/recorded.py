"""What a stored run was an experiment of, also where it was recorded elsewhere."""

from typing import Any

from labrun.spec import Experiment, FitTable, loads_experiment
from labrun.store import imported_channels


def experiment_of(experiment_toml: str, name: str) -> Experiment:
    """Return the experiment of a run.

    An imported recording keeps its ``recording.toml``, which knows neither rig nor gait: it becomes a plain run
    without objectives, of which the first output is what to look at.

    Raises
    ------
    SpecError
        The stored experiment file does not hold.
    """
    channels = imported_channels(experiment_toml)
    if not channels:
        return loads_experiment(experiment_toml, name, plugins=False).experiment
    outputs = [channel for channel, table in channels.items() if table.get("kind") == "output"]
    fit = FitTable(signals={channel: f"output.{channel}" for channel in outputs})
    # Not validated: a rig, a gait and a trial table are what a recording made elsewhere does not have.
    construct: Any = Experiment.model_construct
    experiment: Experiment = construct(
        title=f"Recording {name}", kind="run", fit=fit, objectives={}, units={}
    )
    return experiment


def trial_tare_s(experiment: Experiment) -> float:
    """Return how long a tare takes, s; 0 without one."""
    trial = getattr(experiment, "trial", None)
    return trial.tare.duration_s if trial is not None and trial.tare is not None else 0.0
