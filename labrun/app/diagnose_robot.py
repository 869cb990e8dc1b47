"""Diagnose a robot joint by joint, and store the answer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.app.joints_done import JointsDone
from labrun.app.kept import FOLDER, as_texts, keep, kept_folder
from labrun.app.progress_log import logged, progress_file
from labrun.app.question import ask
from labrun.fit import Dataset, Note, silent
from labrun.gap import (
    FileCheck,
    Options,
    RobotDiagnosis,
    check_file,
    diagnose_robot,
    differences_between_logs,
    require_new,
    why_not,
)
from labrun.gap import save_model as write_model
from labrun.interrupts import Interrupted, number_of
from labrun.models import Robot, read_robot, with_grip_held
from labrun.report import file_check_lines, robot_lines
from labrun.store import find_data, require_writable
from labrun.workers import cores

ROBOT = "robot.xml"


@dataclass(frozen=True, slots=True)
class StoredRobotDiagnosis:
    """A robot's diagnosis and its files; a file is None if not requested."""

    diagnosis: RobotDiagnosis
    numbers: Path
    page: Path | None = None
    figure: Path | None = None
    model: Path | None = None
    warning: str = ""
    check: FileCheck | None = None

    @property
    def was_interrupted(self) -> bool:
        """Whether Ctrl-C ended the search at any joint with its best answer so far."""
        return any(joint.diagnosis.stopped == "interrupted" for joint in self.diagnosis.joints)

    def to_text(self) -> list[str]:
        """Return one line per joint, and the path of the report."""
        files = {"report": self.page or self.numbers}
        if self.model is not None:
            files["saved"] = self.model
        check = [] if self.check is None else file_check_lines(self.check)
        return [*robot_lines(self.diagnosis, files), *check]

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints."""
        files = as_texts(stored=self.numbers, report=self.page, figure=self.figure, saved_model=self.model)
        check = {} if self.check is None else {"file_check": self.check.to_json()}
        return {**self.diagnosis.to_json(), **check, **files}


def joint_by_joint(target: str | Path, results: str | Path = "results") -> str | None:
    """Return why a recording cannot be diagnosed joint by joint: "" if it can, None if it has no robot.

    A recording of a robot has ``robot.xml`` and ``model.toml`` beside its trials, as `import_log` writes it.
    """
    folder = find_data(target, Path(results))
    if not (folder / ROBOT).is_file() or not (folder / "model.toml").is_file():
        return None
    dataset = ask(folder, None).dataset
    return why_not(robot_of(folder, dataset), dataset)


def robot_of(folder: Path, dataset: Dataset) -> Robot:
    """Return the robot of a recording, with the coupled joints of a gripper held at their mean.

    Its remarks are of that alone: what the file lacks was said when the log was imported.
    """
    robot, names = (
        replace(read_robot(folder / ROBOT), remarks=()),
        [output.name for output in dataset.outputs],
    )
    measured = [(joint.name, names.index(joint.output)) for joint in robot.joints if joint.output in names]
    values = np.concatenate([trial.outputs for trial in dataset.trials])
    return with_grip_held(robot, {name: float(np.mean(values[:, column])) for name, column in measured})


def diagnose_joints(
    target: str | Path,
    *,
    withhold: Sequence[str] = (),
    within_s: float | None = None,
    seed: int | None = None,
    workers: int | None = None,
    save_model: Path | None = None,
    page: bool = True,
    results: str | Path = "results",
    note: Note = silent,
) -> StoredRobotDiagnosis:
    """Diagnose every joint of a robot, and store the answer.

    Parameters
    ----------
    target
        A recording folder that `import_log` made of a robot's log.
    withhold
        Effects that the library is to be without.
    within_s
        Time after which every joint ends with its best answer so far; no limit if None.
    save_model
        Where the corrected model of the whole robot goes.
    page
        Whether to write the page and its picture.

    Raises
    ------
    RequestError
        No such recording, or the robot cannot be taken apart into its joints.
    """
    results = Path(results)
    folder = find_data(target, results)
    if save_model is not None:
        require_new(save_model)
    where = kept_folder(folder, results, FOLDER)
    require_writable(where, "the diagnosis")
    question = ask(folder, None)
    options = Options(
        seed=seed or 0,
        withhold=tuple(withhold),
        workers=workers or cores(),
        within_s=float("inf") if within_s is None else within_s,
    )
    robot = robot_of(folder, question.dataset)
    done = JointsDone(where)
    try:
        with logged(note, progress_file(where)) as both:
            diagnosis = diagnose_robot(
                robot, question.model, question.dataset, options, note=both, known=done
            )
    except KeyboardInterrupt as stop:
        if done.file.exists():
            state = "; no diagnosis was written; joints that are done are kept"
            raise Interrupted(number_of(stop), state, hint="the same command resumes them") from None
        raise
    by_log = differences_between_logs(robot, question.model, question.dataset, diagnosis.to_json(), note=note)
    resumed = ("joints that an earlier run had done are taken from it",) if done.resumed else ()
    remarks = (*robot.remarks, *by_log, *diagnosis.remarks, *resumed)
    diagnosis = replace(diagnosis, source=str(folder), remarks=remarks)
    numbers, check = diagnosis.to_json(), None
    if save_model is not None:
        check = check_file(robot, question.model, question.dataset, numbers, note=note)
        numbers["file_check"] = check.to_json()
    note("writing the report" if page else "storing the diagnosis")

    def drawn() -> tuple[str, Any]:
        # matplotlib
        from labrun.report import robot_figure, robot_page

        return robot_page(diagnosis, check), robot_figure(diagnosis)

    kept = keep(where, numbers, question.model.source, drawn if page else None)
    stored = StoredRobotDiagnosis(diagnosis, *kept, check=check)
    if all(joint.diagnosis.complete for joint in diagnosis.joints):
        done.discard()
    if save_model is None or check is None:
        return stored
    write_model({**numbers, **check.model.to_json()}, question.model.source, save_model)
    return replace(stored, model=save_model)
