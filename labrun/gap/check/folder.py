"""The folder of a check: what was asked, the cases, what was said of each as it came, the scores."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.errors import RequestError
from labrun.gap.check.jobs import Files, fingerprint
from labrun.gap.check.sealing import seal_of, sealed_cases

_ASKED = "asked.json"
_MODEL = "model.toml"


@dataclass(frozen=True)
class CheckFolder:
    """Where a check is kept.

    ``cases`` is all that a diagnosis sees; ``fresh`` is for what comes after it; ``sealed`` is opened last.
    """

    path: Path

    @property
    def made(self) -> bool:
        """Whether the cases are there."""
        return (self.path / "seal.json").is_file()

    def ask(self, asked: Mapping[str, Any]) -> str:
        """Write down what was asked for and the seal, or check that the same was asked before; return the seal.

        Raises
        ------
        RequestError
            The folder holds another check, or its seal is no longer the one that was printed.
        """
        path = self.path / _ASKED
        seal = seal_of(self.path)
        if not path.is_file():
            names = sealed_cases(self.path)
            if names != [f"case-{asked['first'] + number:04d}" for number in range(asked["cases"])]:
                raise RequestError(
                    f"{self.path} holds {len(names)} cases from {names[0] if names else 'none'} on; "
                    f"asked for are {asked['cases']} from case-{asked['first']:04d} on",
                    hint="ask for what is there, or name a new folder with --out",
                )
            _write(path, {**asked, "seal": seal})
            return seal
        before = json.loads(path.read_text(encoding="utf-8"))
        if {key: before.get(key) for key in asked} != dict(asked):
            raise RequestError(
                f"{self.path} holds a check of {_words(before)}; asked for is one of {_words(asked)}",
                hint="name a new folder with --out",
            )
        return str(before["seal"])

    def cases(self) -> list[str]:
        """Return the names of the cases, in order."""
        return sealed_cases(self.path)

    def seen(self, case: str) -> Files:
        """Return the files that a diagnosis may see."""
        return _files(self.path / "cases" / case)

    def fresh(self, case: str) -> Files:
        """Return the files of the fresh trials."""
        return _files(self.path / "fresh" / case)

    def model(self, case: str) -> bytes:
        """Return the model file of a case."""
        return (self.path / "cases" / case / _MODEL).read_bytes()

    def said(self, case: str) -> dict[str, Any] | None:
        """Return what was said of a case; None if nothing was yet, or by other code than is here now."""
        found = _read(self.path / "diagnoses" / f"{case}.json")
        return found if found is not None and found.get("programme") == fingerprint() else None

    def keep_said(self, case: str, said: Mapping[str, Any]) -> None:
        """Keep what was said of a case; what its fresh trials showed of an earlier diagnosis goes."""
        (self.path / "shrinkage" / f"{case}.json").unlink(missing_ok=True)
        _write(self.path / "diagnoses" / f"{case}.json", said)

    def shown(self, case: str) -> dict[str, Any] | None:
        """Return what the fresh trials of a case showed; None if they were not looked at yet."""
        return _read(self.path / "shrinkage" / f"{case}.json")

    def keep_shown(self, case: str, shown: Mapping[str, Any]) -> None:
        """Keep what the fresh trials of a case showed."""
        _write(self.path / "shrinkage" / f"{case}.json", shown)

    def keep_scores(self, scores: Mapping[str, Any], table: str) -> None:
        """Write ``check.json`` and ``check.md``."""
        _write(self.path / "check.json", scores)
        _replace(self.path / "check.md", table)


def _files(folder: Path) -> Files:
    try:
        return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}
    except OSError as error:
        raise RequestError(
            f"a case cannot be read: {error}", hint="have the cases made again in a new folder (--out)"
        ) from error


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _write(path: Path, content: Mapping[str, Any]) -> None:
    _replace(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def _replace(path: Path, text: str) -> None:
    """Write a file whole or not at all: an interruption must not leave half an answer."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)


def _words(asked: Mapping[str, Any]) -> str:
    kinds = f" (only {asked['only']})" if asked.get("only") else ""
    return f"{asked['cases']} cases{kinds} of seed {asked['seed']}, from case {asked['first']}"
