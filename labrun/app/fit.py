"""Fit data by a method with a model; store figure and numbers."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun import registry
from labrun.app.check_recording import checked_trials, doubts
from labrun.app.kept import kept_folder, stem_of
from labrun.app.question import declared_plan, fit_plan, named_model
from labrun.errors import RequestError
from labrun.experiment import apply_overrides, find_model_file, load_named
from labrun.fit import GROUP, Dataset, FitJob, FitPlan, FitSummary, Note, is_method, make_method, silent
from labrun.models import load_model, shipped_models
from labrun.report import fit_figure, save_figure
from labrun.store import find_data, is_recording, read_recording, replace_durably, require_writable
from labrun.toml import nearest


def fit(
    target: str | Path,
    data: str | Path | None = None,
    *,
    more: Sequence[str | Path] = (),
    model: str | Path | None = None,
    method: str | None = None,
    signals: Mapping[str, str] | None = None,
    settings: Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    starts: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> FitSummary:
    """Fit a recording or a run; store the result and its figure.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a run.h5, or a recording. Where `data` is given: the
        experiment whose way of fitting is used.
    data
        A recording folder or run to fit in the way of the experiment `target`. A recording with a model.toml of its own
        is fitted with what that knows of the body that was measured.
    more
        Further runs or recordings of the same fit, named like `target`.
    model
        A model file, plugin or name (the workspace's own copy before the shipped one); or the name of a fit, which is
        then the method. Else the experiment's ``[fit] model``; else the recording's model.toml.
    method
        A fit by name. Else the experiment's ``[fit] method``; else "model".
    signals
        Which recorded channel is which input or output; adds to the experiment's ``[fit] signals``.
    settings, overrides
        Of the method, over the experiment's own; `overrides` as ``key=value``.
    seed
        Of starts and resamples; 0 if None, so that the same data give the same numbers.
    starts
        How many; None is what the method takes by itself.
    results
        Where runs are. The fit of a run is kept in the run's own folder, under ``fit/``; that of a recording, which is
        never written to, in ``<results>/<experiment>/fit-<time>/``.
    workspace
        Where a person works: experiments and model files are looked for here.
    note
        Called with what is being done.

    Raises
    ------
    PluginError, RequestError
        No such data, method or model, settings that do not hold, or an experiment that does not say how to fit.
    FitError
        The model cannot be fitted to these data.
    """
    results, workspace = Path(results), Path(workspace)
    folder = find_data(target if data is None else data, results)
    further = tuple(find_data(extra, results) for extra in more)
    if isinstance(model, str) and is_method(model):
        method, model = model, None
    plan = None if data is None else _lent_plan(str(target), folder, workspace, need_model=model is None)
    if isinstance(model, str):
        _require_known(model, workspace)
    given = None if model is None else named_model(model, workspace)
    plan = plan or fit_plan(folder, workspace, need_model=given is None)
    method = method or plan.method
    chosen: dict[str, Any] = dict(settings or {})
    apply_overrides(chosen, overrides)
    way = make_method(method, {**plan.settings_of(method), **chosen})
    kept = kept_folder(folder, results, "fit")
    require_writable(kept, "the fit")
    note(f"reading {folder}")
    wired = {**plan.signals, **(signals or {})}
    rng = np.random.default_rng(seed or 0)
    remarks: list[str] = list(doubts(read_recording(folder))) if is_recording(folder) else []

    def check(data: Dataset) -> Dataset:
        kept, messages = checked_trials(data)
        remarks.extend(messages)
        return kept

    job = FitJob(folder, rng, further, given or plan.model, wired, starts, note, plan.settings_of, check)
    result = way(job)
    result = replace(result, warnings=(*dict.fromkeys(remarks), *result.warnings))
    note("drawing")
    kept.mkdir(parents=True, exist_ok=True)
    stem = stem_of(result.model_name if result.method == "model" else result.method)
    for name, content in result.files.items():
        replace_durably(kept / name, content.encode() if isinstance(content, str) else content)
    drawn = fit_figure(result)
    if drawn is not None:
        result = replace(result, figure=save_figure(drawn, kept / f"{stem}.png"))
    numbers = {
        **result.to_json(),
        "model": result.model_name,
        "method": result.method,
        "source": str(folder),
        **result.record(),
    }
    (kept / f"{stem}.json").write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return result


def _lent_plan(experiment: str, folder: Path, workspace: Path, *, need_model: bool) -> FitPlan:
    """Return the fit that an experiment declares, for other data."""
    loaded = load_named(experiment, workspace)
    table = loaded.experiment.fit
    if table is None:
        raise RequestError(
            f"{experiment} has no [fit] table",
            hint=f"add a [fit] table to its file, or name a model: labrun fit {folder} --model FILE",
        )
    if not is_recording(folder):
        return declared_plan(table, loaded.path, workspace, need_model=need_model)
    # a recording has neither the experiment's devices, which its signals name, nor, perhaps, its body
    own = folder / "model.toml"
    if need_model and own.is_file():
        return FitPlan(table.method, load_model(own))
    return FitPlan(table.method, declared_plan(table, loaded.path, workspace, need_model=need_model).model)


def _require_known(name: str, workspace: Path) -> None:
    """Raise RequestError if a bare name is no model: it may have been meant for a fit."""
    if (
        ":" in name
        or Path(name).suffix == ".toml"
        or find_model_file(name, None, workspace) is not None
        or registry.is_installed("labrun.models", name)
    ):
        return
    models, fits = [*shipped_models(), *registry.names("labrun.models")], registry.names(GROUP)
    if name in models:
        return
    near = nearest(name, [*fits, *models])
    known = f"fits: {', '.join(fits)}; models: {', '.join(models)}, or the path of a .toml file"
    raise RequestError(f"unknown fit or model {name!r}", hint=f"did you mean {near!r}?" if near else known)
