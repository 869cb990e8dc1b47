"""What a run keeps of the file it began with."""

from pathlib import Path
from typing import Any


def source_of(experiment_file: Path) -> dict[str, Any]:
    """Return what provenance keeps of the experiment file, for `changed_keys`: where it is, and its text."""
    text = experiment_file.read_text(encoding="utf-8") if experiment_file.is_file() else None
    return {"experiment_file": str(experiment_file.resolve()), "experiment_text": text}
