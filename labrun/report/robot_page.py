"""The page of a robot's diagnosis: its joints as a picture and a table, then a section a joint."""

from collections.abc import Mapping
from typing import Any

from labrun.gap import JointDiagnosis, RobotDiagnosis
from labrun.report.figures.gap_traces import traces_figure
from labrun.report.figures.robot import robot_figure
from labrun.report.gap_page import parameter_table
from labrun.report.gap_words import VERDICTS, bound_words, ranked, value_words
from labrun.report.page import PageTable, drawn, render
from labrun.report.robot_text import cause_words, joint_rows
from labrun.report.text import listed, number, percent

_SHOWN = 12
_COLUMNS = (
    "joint", "cause", "confidence", "gap recalibrated", "gap with cause", "whole robot: stated", "recalibrated",
    "corrected",
)  # fmt: skip


def robot_page(found: RobotDiagnosis) -> str:
    """Return the page; the same diagnosis gives the same text, byte for byte."""
    rows = joint_rows(found)
    marked = [place for place, one in enumerate(found.joints) if one.diagnosis.causes]
    sections = [_section(one) for one in found.joints]
    return render(
        "robot.html.j2",
        {
            "title": f"{found.name}, joint by joint",
            "r": found,
            "links": [(one["anchor"], one["joint"]) for one in sections],
            "picture": drawn(
                lambda: robot_figure(found), "robot", "Every joint's gap before and after its causes"
            ),
            "joints": PageTable(_COLUMNS, rows, words=(0, 1), marked=marked),
            "sections": sections,
        },
    )


def _section(one: JointDiagnosis) -> Mapping[str, Any]:
    diagnosis = one.diagnosis
    lines = [f"{cause_words(cause)}: {'; '.join(value_words(cause.values))}" for cause in diagnosis.causes]
    for cause in diagnosis.causes:
        rivals = listed([name.words for name in cause.indistinguishable_from], "or")
        lines += [f"These data cannot tell {cause.name.words} from {rivals}."] if rivals else []
    candidates = [
        [
            other.name.words, VERDICTS[other.verdict],
            "" if other.held_out_share is None else percent(other.held_out_share), number(other.evidence, 2),
            "; ".join(bound_words(other.upper_bound) if other.verdict == "ruled-out" else value_words(other.values)),
        ]
        for other in ranked(diagnosis.candidates)[:_SHOWN]
    ]  # fmt: skip
    return {
        "anchor": f"joint-{one.joint.output}",
        "joint": one.joint.name,
        "d": diagnosis,
        "lines": lines,
        "traces": drawn(
            lambda: traces_figure(diagnosis), f"traces-{one.joint.output}", "Measured and simulated"
        ),
        "candidates": PageTable(
            ("candidate", "verdict", "removes", "evidence", "size"), candidates, words=(0, 1, 4)
        ),
        "parameters": parameter_table(diagnosis),
    }
