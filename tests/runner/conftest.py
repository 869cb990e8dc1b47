"""A bench to run on, and an experiment to change piece by piece."""

import pytest
from paddle_lab import Lab, experiment_with

from labrun.store import RunFolder


@pytest.fixture
def folder(tmp_path):
    """Return a new run folder."""
    return RunFolder.create(tmp_path / "results", "paddle", "title = 'x'", {"seed": 1})


@pytest.fixture
def lab(folder, tmp_path):
    """Return a function that makes a lab with changes to the experiment."""

    def make(*, seed=1, limit=None, progress=None, folder=folder, **changes):
        changes.setdefault("rig__devices__tail__stop_log", str(tmp_path / "stops.log"))
        return Lab(folder, experiment_with(**changes), seed=seed, limit=limit, progress=progress)

    return make
