"""The seal over the answers: sha256 of salt and file for each, and one over all of them."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.errors import LabrunError, RequestError

_SEAL = "seal.json"
_SEALED = "sealed"
_NOT_SCORED = "nothing was scored; have the cases made again in a new folder (--out)"


@dataclass(frozen=True, slots=True)
class _Seal:
    over_all: str
    cases: Mapping[str, str]

    @property
    def holds_together(self) -> bool:
        """Whether the hash over all is that of the hashes of the cases."""
        listed = "".join(f"{name}:{self.cases[name]}\n" for name in sorted(self.cases))
        return hashlib.sha256(listed.encode()).hexdigest() == self.over_all


def seal_of(folder: Path) -> str:
    """Return the hash over all answers, as the folder's seal states it.

    Raises
    ------
    RequestError
        The folder has no seal.
    """
    return _stated(folder).over_all


def sealed_cases(folder: Path) -> list[str]:
    """Return the names of the cases that are sealed, in order."""
    return sorted(_stated(folder).cases)


def open_answers(folder: Path, printed: str) -> list[dict[str, Any]]:
    """Check every answer against the seal that was printed before, then return them in the order of their names.

    Parameters
    ----------
    printed
        Hash over all answers, as it was told before the first diagnosis.

    Raises
    ------
    LabrunError
        The seal is another than the one that was printed, or an answer is not the one that was sealed.
    """
    seal = _stated(folder)
    faults = []
    if printed != seal.over_all or not seal.holds_together:
        faults.append(f"{folder / _SEAL} is not the seal that was printed before the diagnosis")
    sealed = folder / _SEALED
    try:
        salt = (sealed / "salt.txt").read_text(encoding="utf-8").strip().encode()
    except OSError as error:
        raise LabrunError(f"the salt of the seal is gone: {error}", hint=_NOT_SCORED) from error
    found = {path.stem: path.read_bytes() for path in sorted(sealed.glob("case-*.json"))}
    faults += [f"{sealed / name}.json is in no seal" for name in sorted(found.keys() - seal.cases.keys())]
    for name, expected in sorted(seal.cases.items()):
        if name not in found:
            faults.append(f"{sealed / name}.json is missing")
        elif hashlib.sha256(salt + found[name]).hexdigest() != expected:
            faults.append(f"{sealed / name}.json was changed after it was sealed")
    if faults:
        raise LabrunError("the seal is broken:\n    " + "\n    ".join(faults), hint=_NOT_SCORED)
    return [json.loads(found[name]) for name in sorted(found)]


def _stated(folder: Path) -> _Seal:
    try:
        content = json.loads((folder / _SEAL).read_text(encoding="utf-8"))
        return _Seal(str(content["all"]), {str(name): str(one) for name, one in content["cases"].items()})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RequestError(
            f"{folder} holds no sealed cases ({type(error).__name__}: {error})",
            hint="name a new folder with --out",
        ) from error
