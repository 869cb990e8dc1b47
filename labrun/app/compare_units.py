"""Compare two units of one kind, two days, or two gains."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from labrun.app.question import ask
from labrun.errors import RequestError
from labrun.fit import Note, silent
from labrun.fit import workers as pool
from labrun.gap import Question, UnitComparison
from labrun.gap import compare_units as compare_datasets
from labrun.store import find_data
from labrun.workers import cores


def compare_units(
    first: str | Path,
    second: str | Path,
    *,
    model: str | Path | None = None,
    signals: Mapping[str, str] | None = None,
    seed: int | None = None,
    workers: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> UnitComparison:
    """Find the parameters and effects that differ between two data sets beyond noise.

    Parameters
    ----------
    first, second
        An experiment's name (its latest run), a run folder, a run.h5, or a recording's name or folder.
    model
        A model file or plugin; else what the first of them names. Sizes of effects it carries are compared, too.
    signals
        Which recorded channel is which input or output of the model; adds to the experiment's own.
    seed
        Of the starts; 0 if None.

    Raises
    ------
    RequestError
        No such data or model, the same data twice, or two that were not recorded alike.
    """
    folders = [find_data(folder, Path(results)) for folder in (first, second)]
    if folders[0].resolve() == folders[1].resolve():
        raise RequestError(f"{folders[0]} was named twice", hint="name the two runs or recordings to compare")
    questions: list[Question] = []
    for folder in folders:
        note(f"reading {folder}")
        source = model if model is not None else questions[0].model.source if questions else None
        questions.append(ask(folder, source, signals=signals, workspace=Path(workspace)))
    with pool(workers or cores()) as each:
        return compare_datasets(
            questions[0].dataset,
            questions[1].dataset,
            questions[0].model,
            np.random.default_rng(seed or 0),
            names=_names(Path(first), Path(second)),
            each=each,
            note=note,
        )


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Return names of two runs or recordings: the last part of their paths if they differ."""
    return (first.name, second.name) if first.name != second.name else (str(first), str(second))
