"""What `labrun fit` was asked for: which data, by which method, with which model."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labrun.errors import RequestError
from labrun.fit.method import Fitted, is_method
from labrun.fit.notes import Note, silent
from labrun.fit.run_fit import FitPlan, fit, plan_from
from labrun.spec.overrides import apply_overrides
from labrun.store.locate import find_run
from labrun.store.recording import is_recording


def fit_request(
    target: str,
    data: str | None = None,
    *,
    more: Sequence[str] = (),
    model: str | None = None,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    results: Path,
    workspace: Path,
    note: Note = silent,
) -> Fitted:
    """Fit what a person named.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a run.h5, or a recording folder. Where `data` is given: the
        experiment whose way of fitting is used.
    data
        A recording folder or run to fit in the way of the experiment `target`. A recording with a model.toml of its own
        is fitted with what that knows of the body that was measured.
    more
        Further runs or recordings of the same fit, named like `target`.
    model
        A model file or plugin, or a fit by name, instead of what the experiment or the recording names.
    overrides
        Settings of the fit, ``key=value``.
    seed
        Of starts and resamples; 0 if None, so that the same data give the same numbers.
    results, workspace
        Where runs are, and where a person works.
    note
        Called with what is being done.

    Raises
    ------
    RequestError
        No such data or experiment; an experiment that does not say how its data are fitted.
    FitError
        The model cannot be fitted to these data.
    """
    folder = _data(target if data is None else data, results)
    need_model = model is None or is_method(model)
    plan = None if data is None else _declared(target, folder, workspace, need_model=need_model)
    settings: dict[str, Any] = {}
    apply_overrides(settings, overrides)
    return fit(
        folder,
        more=[_data(one, results) for one in more],
        model=model,
        settings=settings,
        plan=plan,
        results=results,
        workspace=workspace,
        seed=seed or 0,
        note=note,
    )


def _declared(experiment: str, folder: Path, workspace: Path, *, need_model: bool) -> FitPlan:
    """Return how an experiment declares its fit, for data that may come from elsewhere."""
    from labrun.models import load_model
    from labrun.spec.named import load_named

    loaded = load_named(experiment, workspace)
    table = loaded.experiment.fit
    if table is None:
        raise RequestError(
            f"{experiment} does not say how to fit its data",
            hint=f"give its file a table [fit], or name a model: labrun fit {folder} --model FILE",
        )
    if not is_recording(folder):
        return plan_from(table, loaded.path, workspace, need_model=need_model)
    # a recording has neither the experiment's devices, which its signals name, nor, perhaps, its body
    own = folder / "model.toml"
    if need_model and own.is_file():
        return FitPlan(table.method, load_model(own))
    return FitPlan(table.method, plan_from(table, loaded.path, workspace, need_model=need_model).model)


def _data(target: str, results: Path) -> Path:
    folder = Path(target).expanduser()
    return folder if is_recording(folder) else find_run(target, results)
