"""Check parameters that another tool fitted to a robot's log."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.app.diagnose_robot import diagnose_joints, robot_of
from labrun.app.logs import LogAnswers, import_log
from labrun.app.other_fits import read_fit
from labrun.app.question import ask
from labrun.fit import Note, silent
from labrun.gap import OtherFit, judge_fit
from labrun.report import other_fit_lines


@dataclass(frozen=True, slots=True)
class CheckedFit:
    """Verdicts on another tool's parameters, and the stored diagnosis behind them."""

    fit: OtherFit
    diagnosis: Path

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap check-fit --json`` prints."""
        return {**self.fit.to_json(), "diagnosis": str(self.diagnosis)}

    def to_text(self) -> str:
        """Return the errors of every joint, one line per parameter, and the path of the diagnosis."""
        return "\n".join([*other_fit_lines(self.fit), f"diagnosis  {self.diagnosis}"])


def check_fit(
    result: Path,
    log: Sequence[Path],
    robot_file: Path,
    *,
    answers: LogAnswers | None = None,
    withhold: Sequence[str] = (),
    within_s: float | None = None,
    seed: int | None = None,
    workers: int | None = None,
    results: str | Path = "results",
    note: Note = silent,
) -> CheckedFit:
    """Say which parameters of another tool hold, and which stand in for another cause.

    Parameters
    ----------
    result
        The other tool's file, see `labrun.app.other_fits.read_fit`.
    log
        The robot's logs, which become a recording.
    robot_file
        Its MJCF or URDF file.
    answers
        What a person said of the logs.

    Raises
    ------
    RequestError
        The file holds nothing of the robot, or the robot cannot be taken apart into its joints.
    """
    folder = import_log(log, robot_file, answers=answers).folder
    question = ask(folder, None)
    robot = robot_of(folder, question.dataset)
    values = read_fit(result, robot)  # before minutes of computing
    stored = diagnose_joints(
        folder, withhold=withhold, within_s=within_s, seed=seed, workers=workers, page=False, results=results,
        note=note,
    )  # fmt: skip
    judged = judge_fit(robot, question.model, question.dataset, stored.diagnosis.to_json(), values, note=note)
    return CheckedFit(judged, stored.numbers)
