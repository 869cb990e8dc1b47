"""Resolve the data, fit plan and model that a command names."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from labrun.errors import RequestError
from labrun.experiment import FitTable, GapTable, find_model_file, loads_experiment
from labrun.fit import Dataset, FitPlan, load_dataset, thinned, until_peak
from labrun.gap import Question
from labrun.models import Model, load_model
from labrun.store import imported_channels, is_recording, open_run
from labrun.toml import suggest


def named_model(name: str | Path, workspace: Path, experiment: Path | None = None) -> Model:
    """Return the model of a name or path.

    Parameters
    ----------
    name
        A file, a plugin or ``package.module:object``; or a bare name: the workspace's own
        ``experiments/models/NAME.toml`` comes first, then a plugin's model, then the shipped one.
    workspace, experiment
        Where files are looked for; models may stand beside an experiment's file.

    Raises
    ------
    ModelError, PluginError
        There is none, or it does not hold.
    """
    return load_model(find_model_file(str(name), experiment, workspace) or name)


def fit_plan(target: Path, workspace: Path, *, need_model: bool = True) -> FitPlan:
    """Return the fit plan that the data declare.

    Parameters
    ----------
    target
        A recording folder, a run folder or a run.h5.
    workspace
        Where model files that an experiment names are looked for.

    Raises
    ------
    RequestError
        There is nothing at `target`.
    """
    if is_recording(target):
        path = target / "model.toml"
        return FitPlan(model=load_model(path)) if need_model and path.is_file() else FitPlan()
    if not target.exists():
        raise RequestError(
            f"cannot find a recording or run at {target}",
            hint="labrun list shows the experiments and their runs",
        )
    run = open_run(target)
    if imported_channels(run.experiment_toml):
        return FitPlan()
    table = loads_experiment(run.experiment_toml, run.name, plugins=False).experiment.fit
    return FitPlan() if table is None else declared_plan(table, None, workspace, need_model=need_model)


def declared_plan(
    table: FitTable, experiment: Path | None, workspace: Path, *, need_model: bool = True
) -> FitPlan:
    """Return the plan of an experiment's ``[fit]`` table; `experiment` is its file, beside which models may stand."""
    model = None
    if need_model and table.model is not None:
        model = named_model(table.model, workspace, experiment)
    return FitPlan(table.method, model, table.signals, table.settings, table.methods)


def ask(
    target: Path,
    model: str | Path | None,
    more: Sequence[Path] = (),
    signals: Mapping[str, str] | None = None,
    workspace: Path = Path(),
) -> Question:
    """Return the data and the model of a diagnosis.

    Parameters
    ----------
    model
        A model file, plugin or name, see `named_model`. Else what the experiment's ``[gap]`` or else its ``[fit]``
        names; else the model.toml beside the recording.
    more
        Further recordings or runs that belong to the same question.
    signals
        Which recorded channel is which input or output of the model; adds to the experiment's own.

    Raises
    ------
    RequestError
        There is nothing at `target`, no model is named anywhere, or data do not belong together.
    """
    given = None if model is None else named_model(model, workspace)
    stored_model, wired = held_against(target, given, workspace)
    wired = {**wired, **(signals or {})}
    dataset = _loaded(target, stored_model, wired)
    for other in more:
        dataset = _joined(dataset, _loaded(other, stored_model, wired))
    return Question(dataset, stored_model, wired)


def _loaded(target: Path, model: Model, signals: Mapping[str, str]) -> Dataset:
    """Return trials with the names in ``[gap] repeats`` removed from their conditions."""
    dataset, table = load_held(target, model, signals), _gap_table(target)
    same = set(table.repeats) if table is not None else set()
    used = {meaning.of or name for name, meaning in model.meanings.items()} | set(model.conditions)
    known = sorted(same & used)
    if known:
        raise RequestError(
            f"model {model.name} tells {', '.join(known)} apart, but [gap] repeats declares them as repeats",
            hint="take them out of repeats, or name another model",
        )
    trials = [
        replace(trial, condition={key: value for key, value in trial.condition.items() if key not in same})
        for trial in dataset.trials
    ]
    return replace(dataset, trials=tuple(trials)) if same else dataset


def load_held(target: Path, model: Model, signals: Mapping[str, str]) -> Dataset:
    """Return the trials to compare with a model, restricted as ``[gap]`` states.

    Raises
    ------
    RequestError
        Its ``[gap]`` names an output that the model does not have.
    """
    dataset, table = load_dataset(target, model, signals), _gap_table(target)
    if table is None:
        return dataset
    if table.rate_hz is not None or table.until_s is not None:
        dataset = thinned(dataset, table.rate_hz, table.until_s)
    if table.until_peak is None:
        return dataset
    names = [output.name for output in dataset.outputs]
    if table.until_peak not in names:
        raise RequestError(
            f"[gap] until_peak: model {model.name} has no output {table.until_peak!r}",
            hint=suggest(table.until_peak, names, kind="outputs"),
        )
    return until_peak(dataset, names.index(table.until_peak))


def held_against(target: Path, given: Model | None, workspace: Path) -> tuple[Model, Mapping[str, str]]:
    """Return the model to compare with, and the mapping of its inputs and outputs to channels.

    Raises
    ------
    RequestError
        None is `given`, and none is named anywhere.
    """
    table = _gap_table(target)
    if table is not None:
        return given or named_model(table.model, workspace), table.signals
    plan = fit_plan(target, workspace, need_model=given is None)
    model = given or plan.model
    if model is None:
        raise RequestError(
            f"no model to compare {target} with",
            hint="name one with --model, in [gap] or [fit] of the experiment, or as model.toml beside a recording",
        )
    return model, plan.signals


def _gap_table(target: Path) -> GapTable | None:
    """Return the ``[gap]`` table of a run's experiment; None if it has none."""
    if is_recording(target) or not target.exists():
        return None
    run = open_run(target)
    if imported_channels(run.experiment_toml):
        return None
    return loads_experiment(run.experiment_toml, run.name, plugins=False).experiment.gap


def _joined(dataset: Dataset, other: Dataset) -> Dataset:
    mine = [(signal.name, signal.unit) for signal in (*dataset.inputs, *dataset.outputs)]
    theirs = [(signal.name, signal.unit) for signal in (*other.inputs, *other.outputs)]
    if mine != theirs:
        raise RequestError(
            f"{other.source} has other channels than {dataset.source}: {theirs} beside {mine}",
            hint="diagnose only recordings with the same channels together",
        )
    return replace(
        dataset,
        trials=(*dataset.trials, *other.trials),
        left_out=dataset.left_out + other.left_out,
        notes=(*dataset.notes, *other.notes),
    )
