"""What a worker does: it is handed the files it may see, and nothing else.

Files travel by their content, so that a worker on another machine needs no folder in common, and none can look at an
answer.
"""

import hashlib
import json
import math
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

Files = Mapping[str, bytes]
_MADE_OF = ("effects", "fit", "gap", "models")


def diagnose_case(name: str, files: Files, seed: int) -> dict[str, Any]:
    """Diagnose one case; return what ``labrun gap diagnose --json`` prints, or ``error`` with its reason.

    Parameters
    ----------
    files
        Name and content of the recording's files and of ``model.toml``.
    seed
        Of resamples and simulated noise.
    """
    began = time.perf_counter()
    with TemporaryDirectory(prefix="labrun-check-") as made:
        folder = Path(made)
        _unpack(files, folder)
        try:
            found = _diagnosed(folder, seed)
        except Exception as error:  # whatever goes wrong is a result of this case, not the end of the others
            found = {
                "error": f"{type(error).__name__}: {error}",
                "seconds": round(time.perf_counter() - began, 2),
            }
        return {**_told(found, made, name), "programme": fingerprint()}


def shrink_case(name: str, files: Files, model: bytes, said: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return what fresh trials show of the corrected model; see `labrun.gap.check.shrinking`."""
    from labrun.gap.check.shrinking import shown

    with TemporaryDirectory(prefix="labrun-check-") as made:
        folder = Path(made)
        _unpack({**files, "model.toml": model}, folder)
        try:
            found = shown(folder, said, seed)
        except Exception as error:  # a corrected model that fails on other trials is a result too
            found = {"share": None, "counted": False, "error": f"{type(error).__name__}: {error}"}
        return _told(found, made, name)


@cache
def fingerprint() -> str:
    """Return a hash of the code that diagnoses: results of different code must not pass as one check."""
    import labrun

    root = Path(labrun.__file__).parent
    hashed = hashlib.sha256()
    for part in _MADE_OF:
        for path in sorted((root / part).rglob("*.py")):
            if "check" not in path.relative_to(root).parts:
                hashed.update(path.relative_to(root).as_posix().encode() + b"\n" + path.read_bytes())
    return hashed.hexdigest()[:16]


def _diagnosed(folder: Path, seed: int) -> dict[str, Any]:
    from labrun.gap.diagnose import Options, diagnose_dataset
    from labrun.gap.loading import load_question

    question = load_question(folder, folder / "model.toml", (), {}, folder)
    found = diagnose_dataset(question.dataset, question.model, Options(places=False, seed=seed))
    effects = [
        {"effect": one.effect.id, "kind": one.effect.kind, "site": one.site, "values": list(one.values)}
        for one in found.effects
    ]
    return {**found.to_json(), "effects": effects}


def _unpack(files: Files, folder: Path) -> None:
    for name, content in files.items():
        (folder / Path(name).name).write_bytes(content)


def _told(found: Mapping[str, Any], made: str, name: str) -> dict[str, Any]:
    """Return it JSON-ready, with the case in place of the folder that is gone by then."""
    text = json.dumps(_finite(found), default=str)
    told: dict[str, Any] = json.loads(text.replace(f"{made}/", f"{name}/").replace(made, name))
    return told


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
