"""One small folder of cases that several tests read."""

from pathlib import Path

import pytest
from generating_cases import Done, Generate, generate


@pytest.fixture(scope="session")
def run_generator() -> Generate:
    return generate


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """Three cases, and what the generator said."""
    folder = tmp_path_factory.mktemp("withheld") / "cases-3"
    done = generate("--cases", "3", "--seed", "12", "--out", str(folder))
    assert done.returncode == 0, done.stderr
    return folder, done
