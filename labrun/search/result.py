"""What a run comes to."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labrun.notebook import as_html
from labrun.spec import Value, condition_text

RESULT_FILE = "result.json"
_MOST_REASONS = 4


@dataclass(frozen=True, slots=True)
class Best:
    """The honest best of a run.

    Attributes
    ----------
    parameters
        The winning condition, in the units of the experiment file.
    objective_name, value, unit
        Mean over the confirming trials, which took no part in the choice.
    ci95
        95 % t-interval of that mean; None if fewer than two confirming trials were accepted.
    luckiest
        The best single observation of the whole run, by chance or not: shown beside the value, never instead of it.
    trials
        Number of confirming trials behind `value`.
    """

    parameters: Mapping[str, Value]
    objective_name: str
    value: float
    ci95: tuple[float, float] | None
    unit: str
    luckiest: float
    trials: int = 0

    def to_json(self) -> dict[str, Any]:
        """Return parameters, objective with interval and unit, and the luckiest observation."""
        interval = None if self.ci95 is None else list(self.ci95)
        return {
            "parameters": dict(self.parameters),
            "objective": {"value": self.value, "ci95": interval, "unit": self.unit},
            "luckiest": self.luckiest,
        }

    def to_record(self) -> dict[str, Any]:
        """Return everything, for the run folder."""
        return {**self.to_json(), "objective_name": self.objective_name, "trials": self.trials}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Best":
        """Take back what `to_record` gave."""
        objective = record["objective"]
        interval = objective["ci95"]
        return cls(
            parameters=record["parameters"],
            objective_name=record["objective_name"],
            value=objective["value"],
            ci95=None if interval is None else (interval[0], interval[1]),
            unit=objective["unit"],
            luckiest=record["luckiest"],
            trials=record["trials"],
        )


@dataclass(frozen=True, slots=True)
class RunResult:
    """A run as it stands: finished, or stopped and resumable.

    Attributes
    ----------
    run
        The run's folder.
    done, rejected, failed
        Trials by status, all roles.
    best
        None without an objective that has a goal, and while the run is not finished.
    figure
        Path of the picture; None while the run is not finished.
    reasons
        Why trials were rejected or failed, with their number, most frequent first.
    unsettled
        Trials that count although the bench had not come to rest before them.
    """

    run: Path
    done: int
    rejected: int
    failed: int
    best: Best | None
    figure: Path | None
    finished: bool
    reasons: Mapping[str, int] = field(default_factory=dict)
    unsettled: int = 0

    def to_json(self) -> dict[str, Any]:
        """Return what `--json` prints for run, sweep, cmaes and resume."""
        return {
            "run": str(self.run),
            "trials": {"done": self.done, "rejected": self.rejected, "failed": self.failed},
            "best": None if self.best is None else self.best.to_json(),
        }

    def _repr_html_(self) -> str:
        return as_html(self.to_text(), self.figure)

    def to_text(self) -> str:
        """Return what the terminal shows at the end."""
        lines = [f"trials    {self.done} done, {self.rejected} rejected, {self.failed} failed"]
        lines += reason_lines(self.reasons)
        if self.unsettled:
            lines.append(f"warning   {self.unsettled_text()}")
        if self.best is not None:
            lines += _best_lines(self.best)
        lines.append(f"run       {self.run}")
        if self.figure is not None:
            lines.append(f"figure    {self.figure}")
        if not self.finished:
            lines.append(f"to go on  {resume_line(self.run)}")
        return "\n".join(lines)

    def unsettled_text(self) -> str:
        """Return the warning about trials that were recorded on a bench that was not at rest."""
        return unsettled_text(self.unsettled, self.done)


def stored_result(run: Path) -> RunResult | None:
    """Return the result of a finished run; None if the run is not finished."""
    path = run / RESULT_FILE
    if not path.is_file():
        return None
    record = json.loads(path.read_text(encoding="utf-8"))
    trials = record["trials"]
    figure = run / record["figure"] if record["figure"] is not None else None
    best = None if record["best"] is None else Best.from_record(record["best"])
    return RunResult(
        run,
        trials["done"],
        trials["rejected"],
        trials["failed"],
        best,
        figure,
        finished=True,
        reasons=record.get("reasons", {}),
        unsettled=record.get("unsettled", 0),
    )


def reason_lines(reasons: Mapping[str, int]) -> list[str]:
    """Return the most frequent reasons of rejected and failed trials, one a line, and how many others there are."""
    lines = [f"  {count} x {reason}" for reason, count in list(reasons.items())[:_MOST_REASONS]]
    others = sum(list(reasons.values())[_MOST_REASONS:])
    return [*lines, f"  {others} x other reasons"] if others else lines


def unsettled_text(unsettled: int, done: int) -> str:
    """Return the warning about trials that were recorded on a bench that was not at rest."""
    return (
        f"{unsettled} of {done} accepted trials ({100 * unsettled / max(done, 1):.0f} %) were recorded before the "
        'bench had come to rest: settling ran into trial.settle.timeout_s, and on_timeout = "go-on"'
    )


def resume_line(run: Path) -> str:
    """Return the command that goes on with a run."""
    return f"labrun resume {run}"


def _best_lines(best: Best) -> list[str]:
    if best.ci95 is None:
        interval = "no interval: fewer than two confirming trials were accepted"
    else:
        interval = f"95 % interval {best.ci95[0]:.4g} to {best.ci95[1]:.4g}, {best.trials} confirming trials"
    return [
        f"best      {best.objective_name} = {best.value:.4g} {best.unit} ({interval})",
        f"at        {condition_text(best.parameters, digits=4)}",
        f"luckiest  {best.luckiest:.4g} {best.unit} (best single trial; not what to expect)",
    ]
