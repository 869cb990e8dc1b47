"""labrun: experiments on robot benches, and diagnosis of the gap between simulation and bench.

In Python, the commands are functions: ``labrun.run("hinge", dry_run=True)``, ``labrun.fit("hinge")``,
``labrun.diagnose("hinge")``; and ``labrun.open("hinge")`` gives the data of a stored run.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labrun.app.check import check as check
    from labrun.app.compare import compare as compare
    from labrun.app.compare_units import compare_units as compare_units
    from labrun.app.design import design as design
    from labrun.app.diagnose import diagnose as diagnose
    from labrun.app.doctor import doctor as doctor
    from labrun.app.fit import fit as fit
    from labrun.app.next import plan_trials as plan_trials
    from labrun.app.next import propose_next as propose_next
    from labrun.app.open import open as open  # noqa: A004 - labrun.open is what people call
    from labrun.app.predict_fresh import predict_fresh as predict_fresh
    from labrun.app.rank import rank as rank
    from labrun.app.report import export as export
    from labrun.app.report import report as report
    from labrun.app.resume import resume as resume
    from labrun.app.run import run as run

_USE_CASES = {
    "check": "check",
    "compare": "compare",
    "compare_units": "compare_units",
    "design": "design",
    "diagnose": "diagnose",
    "doctor": "doctor",
    "export": "report",
    "fit": "fit",
    "open": "open",
    "plan_trials": "next",
    "predict_fresh": "predict_fresh",
    "propose_next": "next",
    "rank": "rank",
    "report": "report",
    "resume": "resume",
    "run": "run",
}
"""The Python API: each function, and the module of labrun.app that holds it."""

_PACKAGES = ("design", "fit", "report")
"""Use cases whose name a package has, too: the package itself is callable."""

__all__ = ["__version__"]  # a star import would replace Python's own `open`


class UseCasePackage(ModuleType):
    """A package that is called as its use case: ``labrun.fit("hinge")`` beside ``from labrun.fit import Dataset``."""

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Carry out the use case."""
        return _use_case(self.__name__.rpartition(".")[2])(*arguments, **keywords)


def _use_case(name: str) -> Any:
    return getattr(import_module(f"labrun.app.{_USE_CASES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*_USE_CASES, "__version__"])


def __getattr__(name: str) -> Any:
    """Look names up on demand: numpy, h5py or package metadata cost more than all of `labrun --help`."""
    if name in _USE_CASES:
        return import_module(f"labrun.{name}") if name in _PACKAGES else _use_case(name)
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("labrun")
        except PackageNotFoundError:  # a checkout that was never installed
            return "0+unknown"
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
