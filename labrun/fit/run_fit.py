"""Find out how to fit what, fit it, draw it, and keep the result beside the data or under results."""

import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labrun.errors import RequestError
from labrun.fit.dataset import load_dataset
from labrun.fit.notes import Note, silent
from labrun.fit.result import FitResult
from labrun.store.recording import is_recording

if TYPE_CHECKING:
    from labrun.models import Model
    from labrun.spec.experiment import FitTable

METHODS = {"model": 5, "hinge": 2}
"""Fits by name, and how many starts each takes; a hinge fit starts from its own Fourier estimate."""
FIGURE, NUMBERS = "fit.png", "fit.json"


@dataclass(frozen=True, slots=True)
class FitPlan:
    """How to fit: from a run's experiment, or from what lies beside a recording."""

    method: str = "model"
    model: "Model | None" = None
    signals: Mapping[str, str] = field(default_factory=dict)


def fit(
    target: Path,
    *,
    model: str | Path | None = None,
    method: str | None = None,
    signals: Mapping[str, str] | None = None,
    results: Path = Path("results"),
    workspace: Path = Path(),
    plan: FitPlan | None = None,
    seed: int = 0,
    starts: int | None = None,
    note: Note = silent,
) -> FitResult:
    """Fit a model to a recording or a run, draw the figure, and store both.

    Parameters
    ----------
    target
        A recording folder, a run folder or a run.h5.
    model
        A model file, plugin or shipped name. Else the experiment's `[fit] model`; else the recording's model.toml.
    method
        "model" or "hinge". Else the experiment's `[fit] method`; else "model".
    signals
        See `load_dataset`; adds to the experiment's `[fit] signals`.
    results
        Where the figure of a recording goes: ``results/<recording>/fit-<time>/``. A recording itself is never written
        to; the fit of a run is kept in the run's own folder, under ``fit/``.
    workspace
        Where model files that an experiment names are looked for.
    plan
        What the target would say itself, if someone else says it.
    seed
        Of starts and resamples: the same seed gives the same numbers.
    starts
        How many; None is what the method takes by itself.

    Raises
    ------
    RequestError
        Unknown method, no model named, data that do not match the model.
    FitError
        The model cannot be fitted to these data.
    """
    from labrun.fit.figure import draw_fit
    from labrun.models import load_model

    target = Path(target)
    given = load_model(model) if model is not None else None
    plan = plan or plan_of(target, workspace, need_model=given is None)
    method = method or plan.method
    if method not in METHODS:
        raise RequestError(f"unknown fit method {method!r}", hint=f"methods are {', '.join(METHODS)}")
    wanted = {**plan.signals, **(signals or {})}
    result = _fitted(target, given or plan.model, method, wanted, np.random.default_rng(seed), starts, note)
    note("drawing")
    folder = _output_folder(target, result, results)
    result = replace(result, figure=draw_fit(result, folder / FIGURE))
    numbers = {
        **result.to_json(),
        "model": result.model_name,
        "method": result.method,
        "source": str(target),
        "fixed": dict(result.fixed),
        "findings": list(result.findings),
        "by_trial": [
            {"trial": trial.label, **found}
            for trial, found in zip(result.dataset.trials, result.by_trial, strict=False)
        ],
    }
    (folder / NUMBERS).write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return result


def _fitted(
    target: Path,
    model: "Model | None",
    method: str,
    signals: Mapping[str, str],
    rng: np.random.Generator,
    starts: int | None,
    note: Note,
) -> FitResult:
    note(f"reading {target}")
    starts = METHODS[method] if starts is None else starts
    if method == "hinge":
        from labrun.fit.hinge import fit_hinge
        from labrun.fit.hinge_model import hinge_model

        hinge = hinge_model(model)
        names = {output.name for output in hinge.outputs}
        dataset = load_dataset(
            target, hinge, {name: channel for name, channel in signals.items() if name in names}
        )
        return fit_hinge(dataset, model, rng=rng, starts=starts, note=note)
    if model is None:
        raise RequestError(
            f"no model named for {target}",
            hint="name one with --model FILE, or as [fit] model in the experiment, "
            "or put model.toml beside recording.toml",
        )
    from labrun.fit.output_error import fit_model

    return fit_model(model, load_dataset(target, model, signals), rng=rng, starts=starts, note=note)


def plan_of(target: Path, workspace: Path, *, need_model: bool = True) -> FitPlan:
    """Return what a target says about its own fit.

    Raises
    ------
    RequestError
        There is nothing at `target`.
    """
    from labrun.models import load_model

    if is_recording(target):
        beside = target / "model.toml"
        return FitPlan(model=load_model(beside)) if need_model and beside.is_file() else FitPlan()
    if not target.exists():
        raise RequestError(
            f"there is no recording or run at {target}",
            hint="labrun list shows the experiments and their runs",
        )
    from labrun.fit.run_dataset import imported_channels
    from labrun.spec.loading import loads_experiment
    from labrun.store.reading import open_run

    run = open_run(target)
    if imported_channels(run.experiment_toml):
        return FitPlan()
    table = loads_experiment(run.experiment_toml, run.name, plugins=False).experiment.fit
    return FitPlan() if table is None else plan_from(table, None, workspace, need_model=need_model)


def plan_from(
    table: "FitTable", experiment: Path | None, workspace: Path, *, need_model: bool = True
) -> FitPlan:
    """Return the plan of an experiment's ``[fit]`` table; `experiment` is its file, beside which models may stand."""
    from labrun.models import load_model
    from labrun.spec.workspace import find_model_file

    model = None
    if need_model and table.model is not None:
        model = load_model(find_model_file(table.model, experiment, workspace) or table.model)
    return FitPlan(table.method, model, table.signals)


def _output_folder(target: Path, result: FitResult, results: Path) -> Path:
    if result.dataset.kind == "run":
        folder = (target.parent if target.is_file() else target) / "fit"
    else:
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        folder = results / result.dataset.name / f"fit-{stamp}-{secrets.token_hex(2)}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
