"""Work of a process that sees the files of one case only.

Files travel by their content, so that a worker on another machine needs no folder in common, and none can look at an
answer.
"""

import hashlib
import json
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import labrun
from labrun.fit import load_dataset
from labrun.gap import Options, diagnose_dataset, effects_of, fresh_excess
from labrun.json_numbers import finite
from labrun.models import Model, load_model

Files = Mapping[str, bytes]
_MADE_OF = ("compiled", "effects", "fit", "gap", "models", "toml")
_MODEL = "model.toml"
_COUNTED = 2.0
"""A fresh gap below so many times what noise alone shows is too small for a share of its square to mean anything."""


def diagnose_case(name: str, files: Files, seed: int) -> dict[str, Any]:
    """Diagnose one case; return what ``labrun gap diagnose --json`` prints, or ``error`` with its reason.

    Beside it stand ``processor_s``, the processor seconds that it took, and ``programme``, the `fingerprint`.

    Parameters
    ----------
    files
        Name and content of the recording's files and of ``model.toml``.
    seed
        Of resamples and simulated noise.
    """
    start = time.process_time()
    with TemporaryDirectory(prefix="labrun-check-") as made:
        folder = Path(made)
        _unpack(files, folder)
        try:
            printed = _diagnosed(folder, seed)
        except Exception as error:  # whatever goes wrong is a result of this case, not the end of the others
            printed = {"error": f"{type(error).__name__}: {error}"}
        processor_s = round(time.process_time() - start, 3)
        return {**_told(printed, made, name), "processor_s": processor_s, "programme": fingerprint()}


def shrink_case(
    name: str, files: Files, model: bytes, answers: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    """Return the share of the excess that the announced causes remove from fresh trials; see `shown`."""
    with TemporaryDirectory(prefix="labrun-check-") as made:
        folder = Path(made)
        _unpack({**files, _MODEL: model}, folder)
        try:
            outcome = shown(folder, answers, seed)
        except Exception as error:  # a corrected model that fails on other trials is a result too
            outcome = {"share": None, "counted": False, "error": f"{type(error).__name__}: {error}"}
        return _told(outcome, made, name)


def shown(folder: Path, answers: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Simulate the recalibrated and the corrected model on fresh trials; return the share of the excess removed.

    Parameters are what the diagnosis found; only initial states are fitted, where the model leaves them free or
    lets them begin at the first samples.

    Parameters
    ----------
    folder
        A recording with repeats, with the case's ``model.toml`` beside it.
    answers
        The diagnosis.
    seed
        Of the noise that the smallest gap worth counting is told from.

    Returns
    -------
    dict
        ``share`` removed; ``counted``, whether the fresh gap stands far enough above the noise; ``recalibrated`` and
        ``after``, the gaps in units of one trial's noise; ``floor``, what noise alone shows in 95 of 100.

    Raises
    ------
    FitError
        No repeats, or no excess at all.
    LabrunError
        A corrected model that does not hold, or leaves the finite numbers.
    """
    model = load_model(folder / _MODEL)
    recalibrated = model.with_values(
        {name: parameter["recalibrated"] for name, parameter in answers["recalibration"].items()}
    )
    rng = np.random.default_rng(seed)
    (before, after), floor = fresh_excess(
        [recalibrated, corrected(model, answers)], load_dataset(folder, model), rng
    )
    if before.total <= 0:
        return {"share": 0.0, "counted": False, "recalibrated": 0.0, "after": after.gap, "floor": floor}
    return {
        "share": 1.0 - after.total / before.total,
        "counted": bool(before.gap > _COUNTED * floor),
        "recalibrated": before.gap,
        "after": after.gap,
        "floor": floor,
    }


def corrected(model: Model, answers: Mapping[str, Any]) -> Model:
    """Return the model with the parameters and the effects that a diagnosis gives it."""
    return model.with_values(answers["corrected"]).with_effects(effects_of(answers))


@cache
def fingerprint() -> str:
    """Return a hash of the code that diagnoses: results of different code must not pass as one check."""
    root = Path(labrun.__file__).parent
    hashed = hashlib.sha256()
    for part in _MADE_OF:
        for path in sorted(file for kind in ("*.py", "*.toml") for file in (root / part).rglob(kind)):
            hashed.update(path.relative_to(root).as_posix().encode() + b"\n" + path.read_bytes())
    return hashed.hexdigest()[:16]


def _diagnosed(folder: Path, seed: int) -> dict[str, Any]:
    model = load_model(folder / _MODEL)
    dataset = diagnose_dataset(load_dataset(folder, model), model, Options(places=False, seed=seed))
    return dataset.to_json()


def _unpack(files: Files, folder: Path) -> None:
    for name, content in files.items():
        (folder / Path(name).name).write_bytes(content)


def _told(outcome: Mapping[str, Any], made: str, name: str) -> dict[str, Any]:
    """Return it JSON-ready, with the case in place of the folder that is gone by then."""
    text = json.dumps(finite(outcome), default=str)
    loads: dict[str, Any] = json.loads(text.replace(f"{made}/", f"{name}/").replace(made, name))
    return loads
