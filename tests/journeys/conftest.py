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


@pytest.fixture
def labrun(tmp_path: Path, command: list[str]) -> Labrun:
    """Run labrun with these arguments in an empty folder."""

    def run(*arguments: str | Path, env: dict[str, str] | None = None, cwd: Path = tmp_path) -> Finished:
        done = subprocess.run(
            [*command, *map(str, arguments)],
            cwd=cwd,
            env={**os.environ, **(env or {})},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        return Finished(done.returncode, done.stdout, done.stderr)

    return run
