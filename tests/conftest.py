"""What all tests share."""

import os
from pathlib import Path

import pytest

_BESIDE_THE_CHECKOUT = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the real recordings; a test that asks for it skips where it is absent."""
    folder = Path(os.environ.get("LABRUN_RECORDINGS", _BESIDE_THE_CHECKOUT))
    if not folder.is_dir():
        pytest.skip("the real recordings are not on this machine")
    return folder
