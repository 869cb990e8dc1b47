"""What experiments there are, at a glance; reads titles only, so that it is quick."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from labrun.spec.workspace import list_experiments


@dataclass(frozen=True, slots=True)
class ExperimentSummary:
    """One experiment file: what it is, and how many runs of it there are."""

    name: str
    kind: str
    title: str
    path: Path
    runs: int

    def to_json(self) -> dict[str, str | int]:
        """Return the fields by name."""
        return {
            "name": self.name,
            "kind": self.kind,
            "title": self.title,
            "path": str(self.path),
            "runs": self.runs,
        }


def summarise_workspace(workspace: Path, results: Path) -> list[ExperimentSummary]:
    """Return the experiments of a workspace and those that ship, sorted by name.

    A file that is not TOML is listed too, with what is wrong as its title.
    """
    summaries = [_summarise(path, results) for path in list_experiments(workspace)]
    return sorted(summaries, key=lambda summary: summary.name)


def _summarise(path: Path, results: Path) -> ExperimentSummary:
    runs = sum(1 for _ in (results / path.stem).glob("*/spec.toml"))
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        return ExperimentSummary(path.stem, "?", f"cannot be read: {error}", path, runs)
    return ExperimentSummary(path.stem, str(data.get("kind", "?")), str(data.get("title", "")), path, runs)
