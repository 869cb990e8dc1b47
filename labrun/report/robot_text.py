"""A robot's diagnosis in a terminal: a line a joint."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from labrun.gap import Cause, RobotDiagnosis
from labrun.report.gap_words import HEADLINES, times_noise, value_words
from labrun.report.text import listed, number, percent, short_time_text


def cause_words(cause: Cause) -> str:
    """Return what a cause is called where its joint is known, with what it cannot be told from."""
    told = cause.name.words.partition(" at ")[0]
    if cause.name.site.endswith("_command"):
        told += " of the command"
    same = [name.words for name in cause.indistinguishable_from]
    return told + (f" (or {listed(same, 'or')})" if same else "")


def joint_rows(found: RobotDiagnosis) -> list[list[str]]:
    """Return joint, cause, confidence, gap recalibrated and with causes, and errors in the whole robot, as texts."""
    rows = []
    for one in found.joints:
        diagnosis, gap = one.diagnosis, one.diagnosis.gap
        causes = " + ".join(cause_words(cause) for cause in diagnosis.causes) or HEADLINES[diagnosis.verdict]
        sure = ", ".join(percent(cause.confidence) for cause in diagnosis.causes)
        unit = one.joint.unit
        errors = [f"{number(value, 2)} {unit}" for value in (one.stated, one.recalibrated, one.corrected)]
        after = times_noise(gap.after) if diagnosis.causes else ""
        rows.append([one.joint.name, causes, sure, times_noise(gap.recalibrated), after, *errors])
    return rows


def robot_lines(found: RobotDiagnosis, files: Mapping[str, Path] | None = None) -> list[str]:
    """Return the verdict, a line a joint, the sizes of what was found, and what was written."""
    heads = ["joint", "cause", "sure", "gap", "with cause", "stated", "recalibrated", "corrected"]
    lines = [found.sentence, "", *_aligned([heads, *joint_rows(found)])]
    sizes = [
        f"{cause.name.words}: {'; '.join(value_words(cause.values))}"
        for one in found.joints
        for cause in one.diagnosis.causes
    ]
    lines += ["", *sizes] if sizes else []
    lines += found.remarks
    joints = "joint" if len(found.joints) == 1 else "joints"
    lines.append(f"{len(found.joints)} {joints} in {short_time_text(found.seconds)}")
    return [*lines, *(f"{label}  {path}" for label, path in (files or {}).items())]


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
