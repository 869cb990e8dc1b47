"""Where a diagnosis is kept: with the run, or under results for a recording, which is never written to."""

import json
import secrets
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labrun.errors import RequestError, StoreError
from labrun.gap.diagnosis import Diagnosis
from labrun.gap.saving import recalibrated_only
from labrun.report.gap_figure import FIGURE, draw_gap
from labrun.report.gap_page import write_gap_page
from labrun.report.gap_text import gap_lines
from labrun.store.recording import is_recording

if TYPE_CHECKING:
    from rich.text import Text

FOLDER = "gap"
NUMBERS = "diagnosis.json"


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
    """

    diagnosis: Diagnosis
    numbers: Path
    page: Path | None = None
    figure: Path | None = None
    model: Path | None = None

    @property
    def warning(self) -> str:
        """What to know before using the saved model; "" where there is nothing, or no model was saved."""
        if self.model is None or not recalibrated_only(self.diagnosis):
            return ""
        return (
            f"{self.model} is recalibrated only: the cause is not in the library, and its parameters imitate what is "
            "missing on these data; do not rely on it elsewhere"
        )

    def to_text(self, width: int | None = None) -> "list[Text]":
        """Return the lines of `gap_lines`, and what to open; the terminal's width if none is given."""
        width = shutil.get_terminal_size((100, 24)).columns if width is None else width
        files = {"report": self.page or self.numbers}
        if self.model is not None:
            files["saved"] = self.model
        return gap_lines(self.diagnosis, width, files)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints."""
        named = {
            "stored": self.numbers,
            "report": self.page,
            "figure": self.figure,
            "saved_model": self.model,
        }
        files = {name: None if path is None else str(path) for name, path in named.items()}
        return {**self.diagnosis.to_json(), **files}


def store(diagnosis: Diagnosis, target: Path, results: Path, *, page: bool = True) -> StoredDiagnosis:
    """Write ``diagnosis.json`` and, if asked for, the page and its picture.

    Parameters
    ----------
    diagnosis
        What was found.
    target
        The run folder, run.h5 or recording folder it is of. A run keeps it in its own folder ``gap``, an earlier one in
        ``gap-1``, ``gap-2`` and so on, the oldest first; that of a recording goes to
        ``results/<recording>/gap-<time>``.
    results
        Folder of the runs.

    Raises
    ------
    StoreError
        A file cannot be written.
    """
    folder = _folder(target, results)
    numbers = folder / NUMBERS
    partial = numbers.with_name(f".{NUMBERS}.partial")
    try:
        _put_aside(folder)
        folder.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(_finite(diagnosis.to_json()), indent=2) + "\n", encoding="utf-8")
        partial.replace(numbers)
        if not page:
            return StoredDiagnosis(diagnosis, numbers)
        figure = draw_gap(diagnosis, folder / FIGURE)
    except OSError as error:
        raise StoreError(f"{folder} cannot be written to: {error.strerror}") from error
    return StoredDiagnosis(diagnosis, numbers, write_gap_page(diagnosis, folder), figure)


def read_stored(run: Path) -> Mapping[str, Any]:
    """Return the diagnosis that is kept with a run, as ``--json`` printed it.

    Raises
    ------
    RequestError
        The run has none, or it cannot be read.
    """
    folder = run.parent if run.is_file() else run
    path = folder / FOLDER / NUMBERS
    hint = f"labrun gap diagnose {folder} makes one"
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RequestError(f"{folder.name} has no diagnosis yet", hint=hint) from None
    except (OSError, ValueError) as error:
        raise RequestError(f"{path} cannot be read: {error}", hint=hint) from None
    if not isinstance(stored, dict) or "verdict" not in stored:
        raise RequestError(f"{path} is no diagnosis", hint=hint)
    return stored


def _folder(target: Path, results: Path) -> Path:
    if is_recording(target):
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        return results / target.resolve().name / f"gap-{stamp}-{secrets.token_hex(2)}"
    return (target.parent if target.is_file() else target) / FOLDER


def _put_aside(folder: Path) -> None:
    """Keep an earlier diagnosis under the next free number."""
    if not (folder / NUMBERS).exists():
        return
    number = 1
    while folder.with_name(f"{FOLDER}-{number}").exists():
        number += 1
    folder.rename(folder.with_name(f"{FOLDER}-{number}"))


def _finite(value: Any) -> Any:
    """Return a value with null for every number that JSON has no word for."""
    if isinstance(value, float):
        return value if abs(value) < float("inf") else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list) else value
