"""Use cases, one a file: the only place that composes packages. These functions are the Python API, too."""

from collections.abc import Callable
from importlib import import_module

from labrun.notebook import report_with


def _reporter(name: str) -> Callable[..., str]:
    """Return a function of `labrun.report`, which takes a while to load."""
    function: Callable[..., str] = getattr(import_module("labrun.report"), name)
    return function


report_with(_reporter)
