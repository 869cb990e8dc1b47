"""Makes `emulated`, which stands beside it, importable by the tests of every device; its processes are forked."""

import pytest
from forked_labrun import forked_programs

from labrun.runner import emulated_bench


@pytest.fixture(scope="session", autouse=True)
def emulators_are_forked():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(emulated_bench, "_PYTHON", str(forked_programs() / "forked-python"))
        yield
