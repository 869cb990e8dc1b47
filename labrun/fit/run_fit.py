"""Find out how to fit what, fit it, draw it, and keep the result beside the data or under results."""

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun import registry
from labrun.errors import RequestError
from labrun.fit.method import GROUP, FitJob, Fitted, is_method, make_method, takes
from labrun.fit.notes import Note, silent
from labrun.store.recording import is_recording
from labrun.toml import nearest

if TYPE_CHECKING:
    from labrun.models import Model
    from labrun.spec.experiment import FitTable


@dataclass(frozen=True, slots=True)
class FitPlan:
    """How to fit: from a run's experiment, or from what lies beside a recording.

    `settings` are those of `method`; of another method, `methods` has its own, over those of `settings` it knows too.
    """

    method: str = "model"
    model: "Model | None" = None
    signals: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def settings_of(self, method: str) -> dict[str, Any]:
        """Return the settings of a method."""
        shared = {k: v for k, v in self.settings.items() if method == self.method or takes(method, k)}
        return {**shared, **self.methods.get(method, {})}


def fit(
    target: Path,
    *,
    more: Sequence[Path] = (),
    model: str | Path | None = None,
    method: str | None = None,
    signals: Mapping[str, str] | None = None,
    settings: Mapping[str, Any] | None = None,
    results: Path = Path("results"),
    workspace: Path = Path(),
    plan: FitPlan | None = None,
    seed: int = 0,
    starts: int | None = None,
    note: Note = silent,
) -> Fitted:
    """Fit a recording or a run, draw the figure, and store both.

    Parameters
    ----------
    target
        A recording folder, a run folder or a run.h5.
    more
        Further ones that belong to the same fit.
    model
        A model file, plugin or shipped name; or the name of a fit, which is then the method. Else the experiment's
        `[fit] model`; else the recording's model.toml.
    method
        A fit by name. Else the experiment's `[fit] method`; else "model".
    signals
        See `load_dataset`; adds to the experiment's `[fit] signals`.
    settings
        Of the method; over the experiment's own.
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
    PluginError, RequestError
        Unknown method, no model named, settings or data that do not hold.
    FitError
        The model cannot be fitted to these data.
    """
    from labrun.models import load_model

    target = Path(target)
    if isinstance(model, str) and is_method(model):
        method, model = model, None
    if isinstance(model, str):
        _require_known(model)
    given = load_model(model) if model is not None else None
    plan = plan or plan_of(target, workspace, need_model=given is None)
    method = method or plan.method
    way = make_method(method, {**plan.settings_of(method), **(settings or {})})
    note(f"reading {target}")
    job = FitJob(
        target,
        np.random.default_rng(seed),
        tuple(more),
        given or plan.model,
        {**plan.signals, **(signals or {})},
        starts,
        note,
        plan.settings_of,
    )
    result = way(job)
    note("drawing")
    folder = _output_folder(target, result, results)
    stem = _stem(result)
    result = result.draw(folder, stem)
    numbers = {
        **result.to_json(),
        "model": result.model_name,
        "method": result.method,
        "source": str(target),
        **result.record(),
    }
    (folder / f"{stem}.json").write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return result


def _require_known(name: str) -> None:
    """Raise RequestError if a bare name is no model: it may have been meant for a fit."""
    from labrun.models import shipped_models

    if (
        ":" in name
        or Path(name).suffix == ".toml"
        or Path(name).is_file()
        or registry.is_installed("labrun.models", name)
    ):
        return
    models, fits = [*shipped_models(), *registry.names("labrun.models")], registry.names(GROUP)
    if name in models:
        return
    near = nearest(name, [*fits, *models])
    known = f"fits: {', '.join(fits)}; models: {', '.join(models)}, or the path of a .toml file"
    raise RequestError(
        f"there is no fit or model {name!r}", hint=f"did you mean {near!r}?" if near else known
    )


def _stem(result: Fitted) -> str:
    """Return what the files of a fit are called: several fits of a run stand side by side."""
    name = result.model_name if result.method == "model" else result.method
    return "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in name) or "model"


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
    return FitPlan(table.method, model, table.signals, table.settings, table.methods)


def _output_folder(target: Path, result: Fitted, results: Path) -> Path:
    if result.kind == "run":
        folder = (target.parent if target.is_file() else target) / "fit"
    else:
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        folder = results / result.data_name / f"fit-{stamp}-{secrets.token_hex(2)}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
