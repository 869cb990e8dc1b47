"""labrun as a person or a script starts it."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from forked_labrun import run_labrun


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
    """Return what starts labrun as a new process of Python, to be stopped or killed."""
    return [sys.executable, "-m", "labrun"]


def labrun_in(folder: Path) -> Labrun:
    """Return what runs labrun with given arguments in a folder."""

    def run(*arguments: str | Path, env: dict[str, str] | None = None, cwd: Path = folder) -> Finished:
        done = run_labrun(*arguments, cwd=cwd, env=env)
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
