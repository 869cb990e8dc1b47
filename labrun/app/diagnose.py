"""Run a diagnosis of data with a model, and store its answer."""

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.text import Text

from labrun.app.kept import FOLDER, as_texts, keep, kept_folder, read_stored
from labrun.app.progress_log import logged, progress_file
from labrun.app.question import ask
from labrun.errors import RequestError
from labrun.fit import Note, silent
from labrun.gap import Diagnosis, Options, diagnose_dataset, recalibrated_only, require_new, save_with_law
from labrun.gap import save_model as write_model
from labrun.notebook import as_html
from labrun.report import gap_lines
from labrun.store import find_data, find_run, require_writable
from labrun.workers import cores

if TYPE_CHECKING:
    from labrun.blind import Compared

LAW, LAW_MODEL = "rest-law.toml", "rest-model.toml"


_NOTEBOOK_WIDTH = 100


@dataclass(frozen=True, slots=True)
class StoredDiagnosis:
    """A diagnosis and its files.

    Attributes
    ----------
    numbers
        As ``--json`` prints it.
    page, figure
        None if they were not asked for.
    model
        The corrected model; None if it was not asked for.
    law
        The effect that was proposed for the rest, with the refitted model beside it; None if there is none.
    """

    diagnosis: Diagnosis
    numbers: Path
    page: Path | None = None
    figure: Path | None = None
    model: Path | None = None
    law: Path | None = None

    @property
    def was_interrupted(self) -> bool:
        """Whether Ctrl-C ended the search with its best answer so far."""
        return self.diagnosis.stopped == "interrupted"

    @property
    def warning(self) -> str:
        """Return a caution about the saved model, or ""."""
        return "" if self.model is None else _warning(self.model, self.diagnosis.to_json())

    def _repr_html_(self) -> str:
        return as_html("\n".join(line.plain for line in self.to_text(_NOTEBOOK_WIDTH)), self.figure)

    def to_text(self, width: int | None = None) -> list[Text]:
        """Return the lines of `gap_lines` and the path of the report; `width` defaults to the terminal's."""
        width = shutil.get_terminal_size((100, 24)).columns if width is None else width
        files = {"report": self.page or self.numbers}
        if self.model is not None:
            files["saved"] = self.model
        if self.law is not None:
            files["law"] = self.law
        return gap_lines(self.diagnosis, width, files)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints."""
        law = {} if self.law is None else {"law": self.law, "law_model": self.law.with_name(LAW_MODEL)}
        files = as_texts(
            stored=self.numbers, report=self.page, figure=self.figure, saved_model=self.model, **law
        )
        return {**self.diagnosis.to_json(), **files}


def diagnose(
    target: str | Path,
    *,
    model: str | Path | None = None,
    more: Sequence[str | Path] = (),
    signals: Mapping[str, str] | None = None,
    withhold: Sequence[str] = (),
    within_s: float | None = None,
    seed: int | None = None,
    workers: int | None = None,
    save_model: Path | None = None,
    explain_rest: bool = False,
    page: bool = True,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> StoredDiagnosis:
    """Diagnose where model and data differ, which causes explain it, and how much; store the answer.

    Parameters
    ----------
    target, more
        An experiment's name (its latest run), a run folder, a run.h5, or a recording; and further ones.
    model
        A model file or plugin, instead of what the experiment or the recording names.
    signals
        Which recorded channel is which input or output of the model; adds to the experiment's own.
    withhold
        Effects that the library is to be without.
    within_s
        Time after which the search ends with the best answer so far; no limit if None.
    seed
        0 if None, so that the same data give the same numbers.
    save_model
        Where the corrected model goes.
    explain_rest
        Whether to propose a law for what the causes leave: an effect in ``rest-law.toml``, and the model refitted with
        it in ``rest-model.toml``, beside the diagnosis.
    page
        Whether to write the page and its picture.

    Raises
    ------
    RequestError
        No such data, model or effect, or nothing can be saved where `save_model` says.
    """
    results, workspace = Path(results), Path(workspace)
    folder = find_data(target, results)
    further = [find_data(extra, results) for extra in more]
    if save_model is not None:
        require_new(save_model)
    where = kept_folder(folder, results, FOLDER)
    require_writable(where, "the diagnosis")
    began = time.perf_counter()
    note(f"reading {folder}")
    question = ask(folder, model, further, signals, workspace)
    options = Options(
        seed=seed or 0,
        withhold=tuple(withhold),
        workers=workers or cores(),
        explain_rest=explain_rest,
        within_s=float("inf") if within_s is None else within_s,
    )
    with logged(note, progress_file(where)) as both:
        dataset = diagnose_dataset(question.dataset, question.model, options, note=both, began=began)
    diagnosis = replace(dataset, source=str(folder))
    note("writing the report" if page else "storing the diagnosis")
    stored = store(diagnosis, where, page=page, source=question.model.source)
    if diagnosis.law is not None and diagnosis.law.terms:
        law = stored.numbers.with_name(LAW)
        save_with_law(diagnosis, question.model.source, law, stored.numbers.with_name(LAW_MODEL))
        stored = replace(stored, law=law)
    if save_model is None:
        return stored
    write_model(diagnosis.to_json(), question.model.source, save_model)
    return replace(stored, model=save_model)


def save(
    target: str | Path, file: Path, *, model: str | Path | None = None, results: str | Path = "results"
) -> str:
    """Write the corrected model of a stored diagnosis.

    Parameters
    ----------
    target
        An experiment's name (its latest run), or a run folder, that was diagnosed.
    file
        A new file.
    model
        The model that was diagnosed, if it has moved since.

    Returns
    -------
    str
        What to know before using it; "" where there is nothing.

    Raises
    ------
    RequestError
        There is no diagnosis, the file is there already, or the model that was diagnosed is not where it was.
    """
    run = find_run(str(target), Path(results))
    stored = read_stored(run)
    require_new(file)
    source = model or stored.get("model_source")
    if source is None:
        raise RequestError(
            f"the diagnosis in {run} does not say where its model is", hint="name the model with --model"
        )
    write_model(stored, source, file)
    return _warning(file, stored)


def store(
    diagnosis: Diagnosis, folder: Path, *, page: bool = True, source: str | Path | None = None
) -> StoredDiagnosis:
    """Write ``diagnosis.json`` and, if requested, the page and its figure.

    Parameters
    ----------
    diagnosis
        What was found.
    folder
        Where it is kept, as `kept_folder` returns it. A run keeps it in its own folder ``gap``, an earlier one in
        ``gap-1``, ``gap-2`` and so on, the oldest first; that of a recording goes to
        ``results/<experiment>/gap-<time>``, by the name that it states.
    source
        Where the model came from, for a later `save`.

    Raises
    ------
    StoreError
        A file cannot be written.
    """

    def drawn() -> tuple[str, Any]:
        # matplotlib
        from labrun.report import diagnosis_figure, diagnosis_page

        return diagnosis_page(diagnosis), diagnosis_figure(diagnosis)

    return StoredDiagnosis(diagnosis, *keep(folder, diagnosis.to_json(), source, drawn if page else None))


def reveal(target: str | Path, *, results: str | Path = "results") -> "Compared":
    """Open the seal of a run made with ``--hide``, and compare it with the diagnosis.

    Raises
    ------
    RequestError
        There is no such run, or no diagnosis: the seal stays closed.
    RecordingError
        Nothing is sealed, or the seal is broken.
    """
    from labrun.blind import Compared
    from labrun.blind import reveal as open_seal

    run = find_run(str(target), Path(results))
    stored = read_stored(run)  # without a diagnosis the seal stays closed
    return Compared(open_seal(run), stored)


def _warning(model: Path, diagnosis: Mapping[str, Any]) -> str:
    if not recalibrated_only(diagnosis):
        return ""
    return (
        f"{model} is recalibrated only: the cause is not in the library, and its parameters imitate what is "
        "missing on these data; do not rely on it elsewhere"
    )
