"""Write recordings and model files as a person at the bench would have them, and seal the answers."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from .plant import Condition, FloatArray, Plant

_DIGITS = 8


def write_model(plant: Plant, stated: Mapping[str, float], path: Path) -> None:
    """Write the model file: stated parameters, equations, sites, and nothing of what is hidden."""
    lines = [f'name = "{plant.name}"', f"states = {_list(plant.states)}"]
    lines.append(f"inputs = {_list([signal.name for signal in plant.inputs])}")
    lines.append("[parameters]")
    for parameter in plant.parameters:
        tolerance = '"free"' if parameter.tolerance == "free" else f"{parameter.tolerance}"
        lines.append(
            f"{parameter.name} = {{ value = {stated[parameter.name]!r}, tolerance = {tolerance}, "
            f'unit = "{parameter.unit}" }}'
        )
    lines.append("[equations]")
    lines += [f'{state} = "{plant.equations[state]}"' for state in plant.states]
    lines.append("[outputs]")
    lines += [
        f'{output.name} = {{ equation = "{output.equation}", unit = "{output.unit}" }}'
        for output in plant.outputs
    ]
    for site in plant.sites:
        lines += [f"[sites.{site.name}]", f'kind = "{site.kind}"']
        lines += [f'coordinate = "{site.coordinate}"', f'rate = "{site.rate}"']
        if site.stiffness:
            lines.append(f'stiffness = "{site.stiffness}"')
        if site.load:
            lines.append(f'load = "{site.load}"')
    if plant.states:
        lines.append("[initial]")
        for state in plant.states:
            rule = plant.initial[state]
            lines.append(f"{state} = {_toml(rule)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_recording(
    plant: Plant,
    name: str,
    folder: Path,
    time_s: FloatArray,
    trials: Sequence[tuple[Condition, int, FloatArray, FloatArray]],
) -> None:
    """Write `recording.toml` and a CSV file for each trial.

    `trials`: condition, repeat, inputs (inputs, samples), measured outputs (outputs, samples).
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f'experiment = "{name}"']
    for signal in plant.inputs:
        lines += [
            f"[channels.{signal.name}]",
            'kind = "input"',
            f'unit = "{signal.unit}"',
            f'between = "{signal.between}"',
        ]
    for output in plant.outputs:
        lines += [f"[channels.{output.name}]", 'kind = "output"', f'unit = "{output.unit}"']
    header = ",".join(
        ["time_s", *(signal.name for signal in plant.inputs), *(output.name for output in plant.outputs)]
    )
    for number, (condition, repeat, inputs, outputs) in enumerate(trials, start=1):
        file = f"trial{number:03d}.csv"
        lines += ["", "[[trials]]", f'file = "{file}"', f"repeat = {repeat}"]
        lines.append(
            f"condition = {{ {', '.join(f'{key} = {_toml(value)}' for key, value in condition.items())} }}"
        )
        rows = [header]
        for index, t in enumerate(time_s):
            cells = [f"{t:.9f}"]
            cells += [f"{value:.{_DIGITS}g}" for value in (*inputs[:, index], *outputs[:, index])]
            rows.append(",".join(cells))
        (folder / file).write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "recording.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _list(names: Sequence[str]) -> str:
    quoted = [f'"{name}"' for name in names]
    return f"[{', '.join(quoted)}]"


def _toml(value: float | str) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(float(value))


SALT = "salt.txt"
SEALED = "sealed"
SEAL = "seal.json"


def hash_of(salt: bytes, content: bytes) -> str:
    """Return the salted hash of an answer file."""
    return hashlib.sha256(salt + content).hexdigest()


def over_all(hashes: Mapping[str, str]) -> str:
    """Return one hash over the hashes of all answers, in the order of their names."""
    return hashlib.sha256("".join(f"{name}:{hashes[name]}\n" for name in sorted(hashes)).encode()).hexdigest()


def seal(folder: Path, salt: str) -> dict[str, object]:
    """Write the salt beside the answers and `seal.json` beside their folder; return what it says."""
    sealed = folder / SEALED
    (sealed / SALT).write_text(salt + "\n", encoding="utf-8")
    hashes = {
        path.stem: hash_of(salt.encode(), path.read_bytes()) for path in sorted(sealed.glob("case-*.json"))
    }
    content: dict[str, object] = {
        "algorithm": "sha256(salt + file)",
        "all": over_all(hashes),
        "cases": hashes,
    }
    (folder / SEAL).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return content


def verify(folder: Path) -> list[str]:
    """Return what does not hold of a folder's seal; nothing if the answers are the sealed ones."""
    try:
        content = json.loads((folder / SEAL).read_text(encoding="utf-8"))
        salt = (folder / SEALED / SALT).read_text(encoding="utf-8").strip().encode()
    except (OSError, ValueError) as error:
        return [f"{folder}: no seal to check: {error}"]
    hashes = content["cases"]
    faults = []
    if over_all(hashes) != content["all"]:
        faults.append(f"{folder / SEAL}: the hash over all does not fit the hashes of the cases")
    there = {path.stem: path for path in sorted((folder / SEALED).glob("case-*.json"))}
    faults += [
        f"{path}: an answer that is not in the seal" for name, path in there.items() if name not in hashes
    ]
    for name, expected in hashes.items():
        if name not in there:
            faults.append(f"{folder / SEALED}: the answer of {name} is missing")
        elif hash_of(salt, there[name].read_bytes()) != expected:
            faults.append(f"{there[name]}: changed after it was sealed")
    return faults
