"""Store answers in the folder of their run, or below the results; never in a recording."""

import hashlib
import json
import secrets
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labrun.errors import RequestError, StoreError
from labrun.json_numbers import finite
from labrun.store import is_recording, recording_name, replace_durably

FOLDER = "gap"
NUMBERS = "diagnosis.json"
PAGE = "gap.html"
_FIGURE = "gap_figure.png"
Kept = tuple[Path, Path | None, Path | None]
"""Numbers, page and picture of a diagnosis; None for those that were not asked for."""


def keep(
    folder: Path,
    numbers: Mapping[str, Any],
    source: str | Path | None,
    drawn: Callable[[], tuple[str, Any]] | None,
) -> Kept:
    """Write a diagnosis and the origin of its model; an earlier one is renamed.

    `drawn` makes the page, and the picture as a figure; None if they are not asked for. Raises StoreError: a file
    cannot be written.
    """
    try:
        _put_aside(folder)
        folder.mkdir(parents=True, exist_ok=True)
        values = finite(dict(numbers))
        if source is not None:
            values["model_source"] = str(Path(source).resolve()) if Path(source).is_file() else str(source)
        replace_durably(folder / NUMBERS, (json.dumps(values, indent=2) + "\n").encode())
        if drawn is None:
            return folder / NUMBERS, None, None
        # matplotlib
        from labrun.report import save_figure

        page, figure = drawn()
        picture = save_figure(figure, folder / _FIGURE)
        replace_durably(folder / PAGE, page.encode())
    except OSError as error:
        raise StoreError(f"{folder} cannot be written to: {error.strerror}") from error
    return folder / NUMBERS, folder / PAGE, picture


def as_texts(**files: Path | None) -> dict[str, str | None]:
    """Return paths as JSON has them."""
    return {name: None if path is None else str(path) for name, path in files.items()}


def read_stored(run: Path) -> Mapping[str, Any]:
    """Return the stored diagnosis of a run, as ``--json`` printed it.

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
        raise RequestError(f"{path} is not a diagnosis", hint=hint)
    return stored


def kept_folder(target: Path, results: Path, what: str) -> Path:
    """Return the folder `what` for answers about a run.

    Of a recording, a new one below `results`, beside the runs of its name.
    """
    if is_recording(target):
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        return results / recording_name(target) / f"{what}-{stamp}-{secrets.token_hex(2)}"
    return (target.parent if target.is_file() else target) / what


def stem_of(name: str) -> str:
    """Return the stem of the files of an answer; a run may have several.

    A name in which characters have to be replaced gets a digest of the whole behind it, so that the files of ``a.b``
    and ``a-b`` are two.
    """
    plain = "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in name) or "model"
    return plain if plain == name else f"{plain}-{hashlib.blake2b(name.encode(), digest_size=3).hexdigest()}"


def _put_aside(folder: Path) -> None:
    """Rename an earlier diagnosis with the next free number."""
    if not (folder / NUMBERS).exists():
        return
    number = 1
    while folder.with_name(f"{FOLDER}-{number}").exists():
        number += 1
    folder.rename(folder.with_name(f"{FOLDER}-{number}"))
