"""Where answers about data are kept: beside the run they are of, or below the results; never in a recording."""

import json
import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labrun.errors import RequestError
from labrun.store import is_recording

FOLDER = "gap"
NUMBERS = "diagnosis.json"
PAGE = "gap.html"
FIGURE = "gap_figure.png"


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


def kept_folder(target: Path, results: Path, what: str) -> Path:
    """Return where an answer about a run is kept, its folder `what`; of a recording, a new one below `results`."""
    if is_recording(target):
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        return results / target.resolve().name / f"{what}-{stamp}-{secrets.token_hex(2)}"
    return (target.parent if target.is_file() else target) / what


def stem_of(name: str) -> str:
    """Return what files of this name are called: several answers about one run stand side by side."""
    return "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in name) or "model"


def put_aside(folder: Path) -> None:
    """Keep an earlier diagnosis under the next free number."""
    if not (folder / NUMBERS).exists():
        return
    number = 1
    while folder.with_name(f"{FOLDER}-{number}").exists():
        number += 1
    folder.rename(folder.with_name(f"{FOLDER}-{number}"))
