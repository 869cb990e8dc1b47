"""One run of each kind for all tests of reports: what they read is measured once."""

from pathlib import Path

import pytest
from report_runs import SHORT_CONTROL, SMALL, measure


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> Path:
    """A sweep with a goal, references and an honest best."""
    return measure(tmp_path_factory.mktemp("finished"))


@pytest.fixture(scope="session")
def unfinished(tmp_path_factory) -> Path:
    """A sweep whose title is markup, stopped after its first trials."""
    title = 'title="<script>alert(1)</script>"'
    return measure(tmp_path_factory.mktemp("unfinished"), overrides=(*SMALL, title), limit=4)


@pytest.fixture(scope="session")
def tracked(tmp_path_factory) -> Path:
    """A closed-loop run of which only some controllers have run."""
    return measure(tmp_path_factory.mktemp("tracked"), "force-control", SHORT_CONTROL, limit=5)
