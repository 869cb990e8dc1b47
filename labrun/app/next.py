"""Which trials to make next: before any data, and after a diagnosis, those that best separate what it leaves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labrun.app.question import ask, named_model
from labrun.errors import RequestError
from labrun.experiment import LoadedExperiment, load_named
from labrun.fit import Note, silent
from labrun.fit import workers as pool
from labrun.gap.next import Proposal, RunBench, TrialPlan, free_place, propose, require_experiment_place
from labrun.gap.next import plan_trials as plan
from labrun.models import Model
from labrun.search import at_settings, conditions, settings_of
from labrun.store import find_data, require_writable
from labrun.workers import cores

_RATE_HZ = 100.0


def propose_next(
    target: str | Path,
    *,
    model: str | Path | None = None,
    more: Sequence[str | Path] = (),
    out: Path | None = None,
    seed: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> Proposal:
    """Propose the experiment that best separates what is left of a diagnosis.

    Parameters
    ----------
    target, more, model, seed
        As for `labrun.app.diagnose.diagnose`.
    out
        The experiment file to write; the proposal chooses a name in the workspace if None.

    Raises
    ------
    RequestError
        No such data or model, or nothing is left to separate.
    """
    if out is not None:
        require_experiment_place(out)
    results, workspace = Path(results), Path(workspace)
    folder = find_data(target, results)
    further = [find_data(extra, results) for extra in more]
    note(f"reading {folder}")
    question = ask(folder, model, further, workspace=workspace)
    return propose(folder, question, model=model, out=out, seed=seed or 0, workspace=workspace, note=note)


def plan_trials(
    model: str | Path,
    rig: str | Path,
    *,
    noise: Mapping[str, float] | None = None,
    repeats: int = 3,
    out: Path | None = None,
    seed: int | None = None,
    workers: int | None = None,
    workspace: str | Path = ".",
    note: Note = silent,
) -> TrialPlan:
    """Propose trials before any data, and say which effects they make visible at which size, and which none can.

    Parameters
    ----------
    model
        A model file, plugin or name: the workspace's own copy (``experiments/models/``) comes before the shipped one.
    rig
        The experiment whose rig, gait and limits the trials are to keep: its name, or the path of its file.
    noise : output -> standard deviation of one trial, in the output's unit
        1 % of what an output moves over if not given.
    out
        The experiment file to write; ``experiments/<rig>-plan.toml`` if None.
    seed
        Of the conditions that are looked at; 0 if None.

    Raises
    ------
    RequestError
        No such model or experiment, one that closes a loop, or a file that is there already.
    """
    workspace = Path(workspace)
    if repeats < 1:
        raise RequestError(f"{repeats} repeats: at least 1 was expected")
    if out is not None:
        require_experiment_place(out)
    loaded = load_named(str(rig), workspace)
    chosen = named_model(model, workspace)
    experiment = loaded.experiment
    if experiment.kind == "cmaes":
        raise RequestError(
            f"{loaded.name} searches: it chooses its conditions during the run",
            hint="name an experiment of kind run or sweep on the same rig",
        )
    table = experiment.gap or experiment.fit
    signals = {} if table is None else table.signals
    step_s, messages = _step(loaded, chosen, signals)
    bench = RunBench.planned(
        loaded.name,
        experiment,
        at_settings(conditions(experiment, seed or 0), settings_of(experiment)),
        chosen,
        signals,
        repeats,
        step_s,
    )
    file = out or free_place(workspace / "experiments", f"{loaded.name}-plan")
    require_writable(file.parent, file.name)
    with pool(workers or cores()) as each:
        planned = plan(
            chosen,
            bench,
            np.random.default_rng(seed or 0),
            noise=noise,
            repeats=repeats,
            out=file,
            each=each,
            note=note,
        )
    return replace(planned, notes=(*planned.notes, *messages))


def _step(
    loaded: LoadedExperiment, model: Model, signals: Mapping[str, str]
) -> tuple[float, tuple[str, ...]]:
    """Return the time between samples of the first output, and a sentence where it is assumed."""
    output = model.outputs[0].name
    device = signals.get(output, "").partition(".")[0]
    table = loaded.experiment.rig.devices.get(device)
    rate = None if table is None else table.settings.get("rate_hz")
    if isinstance(rate, int | float) and rate > 0:
        return 1.0 / float(rate), ()
    return 1.0 / _RATE_HZ, (
        f"{output} is taken to be sampled at {_RATE_HZ:g} Hz: no device of the rig states its rate",
    )
