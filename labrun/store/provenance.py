"""Where a run comes from: software, machine, and the state of the workspace."""

import getpass
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from labrun.devices import Identity

_PACKAGES = ("labrun", "numpy", "scipy", "h5py", "numba", "cma")
_GIT_TIMEOUT_S = 10


def collect(workspace: Path, *, seed: int, devices: Mapping[str, Identity] | None = None) -> dict[str, Any]:
    """Return what ``provenance.json`` holds, JSON-ready.

    Parameters
    ----------
    workspace
        Folder whose git state is noted, if it has one.
    seed
        All randomness of the run follows from it.
    devices
        What answered, by name.
    """
    return {
        "seed": seed,
        "devices": {name: asdict(identity) for name, identity in (devices or {}).items()},
        **software_and_machine(),
        "git": git_state(workspace),
    }


def software_and_machine() -> dict[str, Any]:
    """Return the command, the versions of what computes, and the machine."""
    return {
        "command": sys.argv,
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "machine": {
            "host": platform.node(),
            "system": platform.platform(),
            "processors": os.cpu_count(),
            "user": _user(),
        },
    }


def git_state(folder: Path) -> dict[str, Any] | None:
    """Return commit and number of changed files of a workspace; None where there is no git or no commit."""
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        changes = _git(folder, "status", "--porcelain")
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit, "changed_files": len(changes.splitlines())}


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S
    ).stdout.strip()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container without a user database
        return str(os.getuid())
