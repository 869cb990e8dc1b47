"""labrun: an experiment runner for robot benches.

In Python, ``labrun.open("fin-params")`` gives the data of a stored run: its ``trials``, and its ``signals("wrench")``.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labrun.open_run import open as open  # noqa: A004 - labrun.open is what people call

__all__ = ["__version__"]  # without `open`: a star import would replace Python's own


def __getattr__(name: str) -> Any:
    """Look names up on demand: package metadata, or numpy and h5py, cost more than all of `labrun --help`."""
    if name == "open":
        from labrun.open_run import open as open_run

        return open_run
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("labrun")
        except PackageNotFoundError:  # a checkout that was never installed
            return "0+unknown"
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
