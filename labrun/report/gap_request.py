"""What `labrun gap` was asked for: which data, against which model, and what becomes of the answer."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import RequestError
from labrun.report.gap_store import StoredDiagnosis, store
from labrun.store.locate import find_run
from labrun.store.recording import is_recording

if TYPE_CHECKING:
    from labrun.gap.next import Proposal

Note = Callable[[str], None]


def diagnose_request(
    target: str,
    *,
    model: str | None,
    more: Sequence[str],
    withhold: Sequence[str],
    full_guard: bool,
    seed: int | None,
    workers: int | None,
    save_model: Path | None,
    page: bool,
    results: Path,
    workspace: Path,
    note: Note,
) -> StoredDiagnosis:
    """Diagnose what a person named, and keep the answer.

    Parameters
    ----------
    target, more
        An experiment's name (its latest run), a run folder, a run.h5, or a recording folder; and further ones.
    model
        A model file or plugin, instead of what the experiment or the recording names.
    withhold
        Effects that the library is to be without.
    seed
        0 if None, so that the same data give the same numbers.
    save_model
        Where the corrected model goes.
    page
        Whether to write the page and its picture.

    Raises
    ------
    RequestError
        No such data, model or effect, or nothing can be saved where `save_model` says.
    """
    folder = data_of(target, results)
    further = [data_of(one, results) for one in more]
    if save_model is not None:
        _require_place(save_model)
    from labrun.gap.diagnose import Options, diagnose

    options = Options(
        seed=seed or 0, withhold=tuple(withhold), full_guard=full_guard, workers=workers or _cores()
    )
    diagnosis = diagnose(folder, model=model, more=further, options=options, workspace=workspace, note=note)
    note("writing the report" if page else "storing the diagnosis")
    stored = store(diagnosis, folder, results, page=page)
    if save_model is None:
        return stored
    from labrun.gap.saving import save_model as save

    save(diagnosis, model_source(model, folder, workspace), save_model)
    return replace(stored, model=save_model)


def next_request(
    target: str,
    *,
    model: str | None,
    more: Sequence[str],
    out: Path | None,
    seed: int | None,
    results: Path,
    workspace: Path,
    note: Note,
) -> "Proposal":
    """Propose the experiment that best separates what is left of a diagnosis.

    Parameters
    ----------
    target, more, model, seed
        As for `diagnose_request`.
    out
        The experiment file to write; the proposal chooses a name in the workspace if None.

    Raises
    ------
    RequestError
        No such data or model, or nothing is left to separate.
    """
    folder = data_of(target, results)
    further = [data_of(one, results) for one in more]
    from labrun.gap.next import propose

    return propose(
        folder,
        model=model,
        more=further,
        out=out,
        seed=seed or 0,
        workspace=workspace,
        note=note,
    )


def data_of(target: str, results: Path) -> Path:
    """Return the run or recording that a person means.

    Raises
    ------
    RequestError
        There is none; names what is nearest.
    """
    folder = Path(target).expanduser()
    return folder if is_recording(folder) else find_run(target, results)


def model_source(model: str | None, folder: Path, workspace: Path) -> str:
    """Return where the model of a diagnosis comes from: as it was named, or as the data name it.

    Raises
    ------
    RequestError
        Nobody names a model.
    """
    if model is not None:
        return model
    from labrun.gap.naming import plan_for

    return plan_for(folder, None, workspace).model.source


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _require_place(path: Path) -> None:
    """Raise RequestError before minutes of computing if the corrected model could not be written."""
    if path.is_dir():
        raise RequestError(f"{path} is a folder", hint="--save-model takes a file, e.g. corrected.toml")
    if not path.absolute().parent.is_dir():
        raise RequestError(f"there is no folder {path.parent} to save the corrected model in")
