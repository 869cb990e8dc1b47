"""What all tests share."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import rendering
import unsynced
from hypothesis import settings
from hypothesis.internal.conjecture import providers

# The same few examples on every run; LABRUN_HYPOTHESIS=explore looks for new ones, and for more.
settings.register_profile("same", derandomize=True, deadline=None, max_examples=40)
settings.register_profile("explore", deadline=None)
_PROFILE = os.environ.get("LABRUN_HYPOTHESIS", "same")
settings.load_profile(_PROFILE)
if _PROFILE == "same":
    # Hypothesis also draws constants of the modules imported so far, which depend on the tests that ran before.
    providers._get_local_constants = lambda: providers._local_constants

# before numpy is imported: labrun's matrices are small, and BLAS threads on shared cores mostly wait for one another
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
gc.set_threshold(100_000, 20, 20)  # as the command line does: what imports make stays

_BESIDE_THE_CHECKOUT = Path(__file__).parents[2] / "shared" / "data"


_IN_REAL_TIME = (
    "tests/emulated",
    "tests/plugins",
    "tests/runner/test_emulated_bench.py",
    "tests/devices/test_pacing.py",
)
_WITHOUT_DEVICES = ("tests/plugins/simulated", "tests/plugins/cases")


@pytest.hookimpl(tryfirst=True)  # groups are read by xdist in the same hook
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let tests in real time try again, and keep tests that share what is made once for a file together.

    A busy machine may stop a test that talks to another process, or that process, for a while. A rerun is told in the
    summary; a test that fails three times has failed.
    """
    for item in items:
        module_path = Path(item.path).relative_to(config.rootpath).as_posix()
        in_real_time = module_path.startswith(_IN_REAL_TIME) and not module_path.startswith(_WITHOUT_DEVICES)
        if in_real_time and config.pluginmanager.hasplugin("rerunfailures"):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=1))
        if isinstance(item, pytest.Function):
            made = item._fixtureinfo.name2fixturedefs
            if any(
                fixture.scope == "module" for name2fixturedef in made.values() for fixture in name2fixturedef
            ):
                item.add_marker(pytest.mark.xdist_group(module_path))


def pytest_collection_finish() -> None:
    """Leave what was collected and imported out of every later collection of garbage."""
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Take two workers more than there are cores: a third of what tests take is waiting for devices and processes."""
    return (os.cpu_count() or 1) + 2


@pytest.fixture(scope="session", autouse=True)
def _shortcuts() -> None:
    rendering.leave_pictures_empty()
    unsynced.leave_files_unsynced()


@pytest.fixture(autouse=True)
def _rendered_pictures(request: pytest.FixtureRequest) -> Iterator[None]:
    if request.node.get_closest_marker("rendered") is None:
        yield
    else:
        with rendering.rendered():
            yield


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the real recordings; a test that asks for it skips where it is absent."""
    folder = Path(os.environ.get("LABRUN_RECORDINGS", _BESIDE_THE_CHECKOUT))
    if not folder.is_dir():
        pytest.skip("the real recordings are not on this machine")
    return folder
