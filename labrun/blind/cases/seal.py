"""Seals: a salted hash of every answer, printed before anyone looks at the cases, and checked after."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

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
