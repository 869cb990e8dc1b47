"""Short dry runs for the tests of reports."""

from pathlib import Path

from labrun.app.run import run as execute
from labrun.experiment import load_named
from labrun.runner import SilentProgress

SMALL = ("sweep.axes.b=[0]", "sweep.axes.a=[20, 60]", "sweep.axes.f=[0.7, 1.4]", "trial.reference.every=5")
SHORT_CONTROL = (
    "trial.duration_s=6", "trial.repeats=2",
    "objectives.first_cycle.to_s=3", "objectives.later.from_s=3", "objectives.later.to_s=6",
)  # fmt: skip


def measure(results: Path, name: str = "fin-params", overrides=SMALL, limit: int | None = None) -> Path:
    """Return the folder of a dry run."""
    loaded = load_named(name, results, overrides)
    progress = SilentProgress()
    return execute(
        loaded, results=results, dry_run=True, seed=3, limit=limit, progress=progress, draw=False
    ).run
