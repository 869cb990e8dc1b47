"""The command as a person or a script starts it: a process of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest


@dataclass(frozen=True)
class Finished:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Labrun = Callable[..., Finished]


@pytest.fixture
def command() -> list[str]:
    return [sys.executable, "-m", "labrun"]


def labrun_in(folder: Path) -> Labrun:
    """Return what runs labrun with given arguments in a folder."""

    def run(*arguments: str | Path, env: dict[str, str] | None = None, cwd: Path = folder) -> Finished:
        done = subprocess.run(
            [sys.executable, "-m", "labrun", *map(str, arguments)],
            cwd=cwd,
            env={**os.environ, **(env or {})},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        return Finished(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def labrun(tmp_path: Path) -> Labrun:
    """Run labrun with these arguments in an empty folder."""
    return labrun_in(tmp_path)


@pytest.fixture(scope="module")
def labrun_once(tmp_path_factory: pytest.TempPathFactory) -> tuple[Labrun, Path]:
    """Run labrun for all tests of a file, and the folder it does that in."""
    folder = tmp_path_factory.mktemp("once")
    return labrun_in(folder), folder
