"""Where the answer of a diagnosis is kept, and how it is read again."""

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


def diagnosis_folder(target: Path, results: Path) -> Path:
    """Return where the diagnosis of a run or a recording is kept."""
    if is_recording(target):
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        return results / target.resolve().name / f"gap-{stamp}-{secrets.token_hex(2)}"
    return (target.parent if target.is_file() else target) / FOLDER


def put_aside(folder: Path) -> None:
    """Keep an earlier diagnosis under the next free number."""
    if not (folder / NUMBERS).exists():
        return
    number = 1
    while folder.with_name(f"{FOLDER}-{number}").exists():
        number += 1
    folder.rename(folder.with_name(f"{FOLDER}-{number}"))
