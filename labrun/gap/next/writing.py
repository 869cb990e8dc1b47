"""The proposal as files: an experiment that labrun runs, or a recording that waits for its outputs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun.errors import RequestError

if TYPE_CHECKING:
    from labrun.fit.dataset import Dataset
    from labrun.gap.next.run_bench import RunBench
    from labrun.gap.next.trials import PlannedTrial


def free_place(folder: Path, stem: str, name: str = "") -> Path:
    """Return a path in a folder that is not taken: ``stem.toml``, ``stem-2.toml`` ...; or a folder's file `name`."""
    for number in range(1, 1000):
        numbered = stem if number == 1 else f"{stem}-{number}"
        path = folder / numbered / name if name else folder / f"{numbered}.toml"
        if not path.exists():
            return path
    raise RequestError(f"{folder} holds a thousand proposals already", hint="say where with --out")


def require_free(path: Path) -> None:
    """Raise RequestError if something is there."""
    if path.exists():
        raise RequestError(f"{path} is there already", hint="name another file, or move that one away")


def experiment_text(
    bench: "RunBench", trials: "Sequence[PlannedTrial]", remarks: Sequence[str], model: str | None
) -> str:
    """Return the experiment file of chosen trials.

    Parameters
    ----------
    remarks
        What the head of the file says.
    model
        Instead of the one that its ``[gap]`` names; None leaves that.
    """
    import tomli_w

    tree = _without_defaults(bench)
    tree["title"] = f"{tree['title']}: what tells the causes apart"
    tree["run"] = {"conditions": [dict(trial.condition) for trial in trials]}
    if model is not None:
        tree["gap"] = {**tree.get("gap", {}), "model": model}
    head = "".join(f"# {line}\n" for line in remarks)
    return f"{head}{tomli_w.dumps(tree)}"


def write_experiment(path: Path, text: str) -> None:
    """Write the file, and read it again as `labrun check` does.

    Raises
    ------
    RequestError
        It cannot be written.
    SpecError
        What was written does not hold.
    """
    from labrun.spec import load_experiment

    _write(path, text)
    load_experiment(path)


def write_recording_plan(
    path: Path,
    name: str,
    dataset: "Dataset",
    trials: "Sequence[PlannedTrial]",
    repeats: int,
    remarks: Sequence[str],
) -> None:
    """Write a recording whose outputs are still to be measured: its toml, and the inputs of every trial as CSV."""
    import tomli_w

    channels: dict[str, Any] = {}
    for signal in dataset.inputs:
        channels[signal.name] = {"kind": "input", "unit": signal.unit, "between": signal.between}
    for signal in dataset.outputs:
        channels[signal.name] = {"kind": "output", "unit": signal.unit}
    entries = [
        {"file": f"trial-{number}-{repeat}.csv", "condition": dict(trial.condition), "repeat": repeat}
        for number, trial in enumerate(trials, start=1)
        for repeat in range(1, repeats + 1)
    ]
    columns = ", ".join(signal.name for signal in dataset.outputs)
    head = [
        *remarks,
        f"Each CSV file holds time and inputs of one trial; what was measured goes beside them as {columns}.",
    ]
    text = "".join(f"# {line}\n" for line in head)
    text += tomli_w.dumps({"experiment": name, "channels": channels, "trials": entries})
    _write(path, text)
    header = ",".join(["time_s", *(signal.name for signal in dataset.inputs)])
    for number, trial in enumerate(trials, start=1):
        table = np.column_stack([trial.time_s, trial.inputs])
        for repeat in range(1, repeats + 1):
            file = path.parent / f"trial-{number}-{repeat}.csv"
            require_free(file)
            np.savetxt(file, table, delimiter=",", header=header, comments="", fmt="%.9g")


def _without_defaults(bench: "RunBench") -> dict[str, Any]:
    """Return the experiment's tables as a person would write them: what is as it always is, left out."""
    found: dict[str, Any] = bench.experiment.model_dump(
        mode="python", by_alias=True, exclude_none=True, exclude_defaults=True
    )
    repeats = found.get("trial", {}).get("repeats")
    if isinstance(repeats, Mapping) and repeats.get("min") == repeats.get("max"):
        found["trial"]["repeats"] = repeats["min"]
    return found


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RequestError(f"{path} cannot be written: {error.strerror}") from error
