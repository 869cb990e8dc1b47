"""Results of a run."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labrun.errors import RecordingError
from labrun.experiment import Value, condition_text, value_text
from labrun.notebook import as_html
from labrun.search.ending import Verdict

RESULT_FILE = "result.json"
_MOST_REASONS = 4
_MEASURED = re.compile(r"= -?\d\S*")


@dataclass(frozen=True, slots=True)
class Best:
    """The confirmed best of a run.

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
    truncation
        The part of the interval, to either side, that cycles cut by the window make; see `labrun.experiment.Averaging`.
    range_ends
        Sentences on the ranges at whose end the winner stands, see `labrun.search.range_ends`.
    combined
        What of several settings `value` is, as ``sum over v = 0.1, 0.3 m/s``; empty where there is one setting.
    """

    parameters: Mapping[str, Value]
    objective_name: str
    value: float
    ci95: tuple[float, float] | None
    unit: str
    luckiest: float
    trials: int = 0
    truncation: float = 0.0
    range_ends: tuple[str, ...] = ()
    combined: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return parameters, objective with interval and unit, and the luckiest observation."""
        interval = None if self.ci95 is None else list(self.ci95)
        return {
            "parameters": dict(self.parameters),
            "objective": {"value": self.value, "ci95": interval, "unit": self.unit},
            "luckiest": self.luckiest,
            **({"truncation": self.truncation} if self.truncation else {}),
            **({"range_ends": list(self.range_ends)} if self.range_ends else {}),
            **({"combined": self.combined} if self.combined else {}),
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
            truncation=record.get("truncation", 0.0),
            range_ends=tuple(record.get("range_ends", ())),
            combined=record.get("combined", ""),
        )


@dataclass(frozen=True, slots=True)
class RunResult:
    """The state of a run: finished, or stopped and resumable.

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
    verdicts
        How each search ended; empty without one.
    winners
        Of a search for each level of a factor: the honest best of each level, best first.
    more
        What more there is to say of it, a line each.
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
    verdicts: tuple[Verdict, ...] = ()
    winners: tuple[Best, ...] = ()
    more: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return what `--json` prints for run, sweep, cmaes and resume."""
        return {
            "run": str(self.run),
            "trials": {"done": self.done, "rejected": self.rejected, "failed": self.failed},
            "best": None if self.best is None else self.best.to_json(),
            **self.searches_to_json(),
        }

    def searches_to_json(self) -> dict[str, Any]:
        """Return how each search ended and the winners of several, JSON-ready; empty where nothing was searched."""
        return {
            **({"search": [verdict.to_record() for verdict in self.verdicts]} if self.verdicts else {}),
            **({"winners": [winner.to_json() for winner in self.winners]} if self.winners else {}),
        }

    def search_lines(self) -> list[str]:
        """Return how each search ended and the winners of several, a line each."""
        lines = []
        for verdict in self.verdicts:
            where = f"{condition_text(verdict.level)}: " if verdict.level else ""
            lines.append(f"search    {where}{verdict.text}")
        return lines + winner_lines(self.winners, [verdict.level or {} for verdict in self.verdicts])

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
        lines += self.search_lines()
        lines += self.more
        lines.append(f"run       {self.run}")
        if self.figure is not None:
            lines.append(f"figure    {self.figure}")
        if not self.finished:
            lines.append(f"continue  {resume_line(self.run)}")
        return "\n".join(lines)

    def unsettled_text(self) -> str:
        """Return the warning about trials that were recorded on a bench that was not at rest."""
        return unsettled_text(self.unsettled, self.done)


def stored_result(run: Path) -> RunResult | None:
    """Return the result of a finished run; None if the run is not finished.

    Raises
    ------
    RecordingError
        The result is damaged; the trials it was made from are not in that file.
    """
    path = run / RESULT_FILE
    if not path.is_file():
        return None
    try:
        return _from_record(run, json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, LookupError, TypeError) as error:
        raise RecordingError(
            f"{path} is damaged: {error}",
            hint=f"the trials are in the run's other files: delete this one, and {resume_line(run)} writes it again",
        ) from error


def _from_record(run: Path, record: Mapping[str, Any]) -> RunResult:
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
        verdicts=tuple(Verdict.from_record(verdict) for verdict in record.get("search", ())),
        winners=tuple(Best.from_record(winner) for winner in record.get("winners", ())),
        more=tuple(record.get("more", ())),
    )


def winner_lines(winners: Sequence[Best], levels: Sequence[Mapping[str, Value]]) -> list[str]:
    """Return the winners of the levels of a factor, one a line, and whether the best one stands apart."""
    if not winners:
        return []
    names = list(dict.fromkeys(name for level in levels for name in level))
    lines = []
    for best in winners:
        at = condition_text({name: best.parameters[name] for name in names})
        interval = "no interval" if best.ci95 is None else f"{best.ci95[0]:.4g} to {best.ci95[1]:.4g}"
        value = value_text(best.value, best.unit, digits=4)
        lines.append(f"winner    {at}: {best.objective_name} = {value} ({interval})")
    return lines if len(winners) == 1 else [*lines, f"          {apart_text(winners, levels)}"]


def apart_text(winners: Sequence[Best], levels: Sequence[Mapping[str, Value]]) -> str:
    """Tell whether the best of the winners of several levels stands apart from all others."""
    names = list(dict.fromkeys(name for level in levels for name in level))
    first, *others = winners
    at = condition_text({name: first.parameters[name] for name in names})
    near = [other for other in others if not _apart(first, other)]
    if not near:
        return f"{at} stands apart: its 95 % interval overlaps no other"
    rest = " and ".join(
        condition_text({name: candidate.parameters[name] for name in names}) for candidate in near
    )
    return f"{at} is not distinguishable from {rest}: their 95 % intervals overlap"


def _apart(best: Best, other: Best) -> bool:
    if best.ci95 is None or other.ci95 is None:
        return False
    return best.ci95[0] > other.ci95[1] or best.ci95[1] < other.ci95[0]


def reason_lines(reasons: Mapping[str, int]) -> list[str]:
    """Return the most frequent reasons of rejected and failed trials, one a line, and how many others there are.

    Reasons that differ in a measured number only are one: the most frequent of them is shown.
    """
    alike: dict[str, list[tuple[int, str]]] = {}
    for reason, count in reasons.items():
        alike.setdefault(_MEASURED.sub("=", reason), []).append((count, reason))
    groups = sorted(
        (
            (sum(count for count, _ in repeats), max(repeats, key=lambda item: item[0])[1], len(repeats))
            for repeats in alike.values()
        ),
        key=lambda group: -group[0],
    )
    lines = [
        f"  {count} x {reason}" + (", or nearly so" if different > 1 else "")
        for count, reason, different in groups[:_MOST_REASONS]
    ]
    others = sum(count for count, _, _ in groups[_MOST_REASONS:])
    return [*lines, f"  {others} x other reasons"] if others else lines


def unsettled_text(unsettled: int, done: int) -> str:
    """Return the warning about trials that were recorded on a bench that was not at rest."""
    return (
        f"{unsettled} of {done} accepted trials ({100 * unsettled / max(done, 1):.0f} %) were recorded before the "
        'bench had come to rest: settling ran into trial.settle.timeout_s, and on_timeout = "go-on"'
    )


def resume_line(run: Path) -> str:
    """Return the command that resumes a run."""
    return f"labrun resume {run}"


def _best_lines(best: Best) -> list[str]:
    if best.ci95 is None:
        interval = "no interval: fewer than two confirming trials were accepted"
    else:
        interval = f"95 % interval {best.ci95[0]:.4g} to {best.ci95[1]:.4g}, {best.trials} confirming trials"
    value, luckiest = (value_text(number, best.unit, digits=4) for number in (best.value, best.luckiest))
    truncation = value_text(best.truncation, best.unit, digits=2)
    cut = [f"          of that, {truncation} to either side for cycles that the window cuts"]
    combined = f", {best.combined}" if best.combined else ""
    return [
        f"best      {best.objective_name} = {value}{combined} ({interval})",
        *(cut if best.truncation and best.ci95 is not None else []),
        f"at        {condition_text(best.parameters, digits=4)}",
        *(f"          {note}" for note in best.range_ends),
        f"luckiest  {luckiest} (best single trial; not what to expect)",
    ]
