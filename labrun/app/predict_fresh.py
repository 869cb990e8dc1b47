"""Test a model on data that its fit has not used."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labrun.app.question import ask, named_model
from labrun.errors import LabrunError, RequestError
from labrun.fit import Dataset, Note, silent
from labrun.gap import FreshTest
from labrun.gap import predict_fresh as predict
from labrun.models import Model, load_model
from labrun.store import find_data


def predict_fresh(
    model: str | Path,
    fresh: str | Path,
    *,
    horizons_s: Sequence[float] | None = None,
    predictions_of: str | Path | None = None,
    signals: Mapping[str, str] | None = None,
    seed: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> FreshTest:
    """Return the errors of a model on fresh data, by prediction horizon.

    Parameters
    ----------
    model
        A model file, plugin or name, as of `compare`; a corrected one knows what it came from.
    fresh
        An experiment's name (its latest run), a run folder, a run.h5, or a recording's name or folder.
    horizons_s
        How far ahead; 0.1, 0.5 and 2 s, as far as the trials reach, if None.
    predictions_of
        The model to set beside it, instead of the one it came from.
    signals
        Which recorded channel is which input or output of the model; adds to the experiment's own.
    seed
        Of the resamples; 0 if None.

    Raises
    ------
    RequestError
        No such data or model, data the model was corrected by (under another name, too), or a horizon that no trial is
        long enough for.
    """
    folder = find_data(fresh, Path(results))
    chosen = named_model(model, Path(workspace))
    if chosen.origin is not None and chosen.origin.data and _same(chosen.origin.data, folder):
        raise RequestError(
            f"{model} was fitted to {folder}; a test needs data that its fit has not used",
            hint="record the bench again, if possible in another condition, and name the run with --fresh",
        )
    note(f"reading {folder}")
    question = ask(folder, model, signals=signals, workspace=Path(workspace))
    fitted = "" if chosen.origin is None else chosen.origin.data
    if fitted and (again := _seen_again(question.dataset, fitted, model, signals, Path(workspace))):
        raise RequestError(
            f"{folder} holds {again}, which {model} was corrected by",
            hint="record the bench again, or name a recording without these trials with --fresh",
        )
    before, missing = (
        (named_model(predictions_of, Path(workspace)), ()) if predictions_of is not None else _origin(chosen)
    )
    predicted = predict(
        question.model,
        question.dataset,
        np.random.default_rng(seed or 0),
        before=before,
        horizons_s=horizons_s,
        note=note,
    )
    return replace(predicted, notes=(*predicted.notes, *missing))


def _same(path: str, other: Path) -> bool:
    return Path(path).resolve() == other.resolve()


def _seen_again(
    fresh: Dataset, data: str, model: str | Path, signals: Mapping[str, str] | None, workspace: Path
) -> str:
    """Name the trials of the fresh data that the model was fitted to; "" if none.

    Trials that stand still are alike without being the same. What cannot be read any more is not compared.
    """
    for names in (signals, None):  # the fresh data may name its channels otherwise
        try:
            fitted = ask(Path(data), model, signals=names, workspace=workspace).dataset
        except LabrunError:
            continue
        seen = {trial.inputs.tobytes() + trial.outputs.tobytes() for trial in fitted.trials}
        again = [
            trial.label
            for trial in fresh.trials
            if np.ptp(trial.outputs, axis=0).any()
            and trial.inputs.tobytes() + trial.outputs.tobytes() in seen
        ]
        return again[0] if len(again) == 1 else f"{len(again)} trials" if again else ""
    return ""


def _origin(model: Model) -> tuple[Model | None, tuple[str, ...]]:
    """Return the model before correction, or a sentence that says why it is not available."""
    if model.origin is None:
        return None, ("the model does not state its origin; name another one with --beside MODEL",)
    try:
        return load_model(model.origin.model), ()
    except LabrunError as error:
        return None, (
            f"the model it came from cannot be read ({error.args[0]}): name it with --beside MODEL",
        )
