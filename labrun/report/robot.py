"""A robot diagnosed joint by joint: its lines in a terminal, its page, and its figure."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from labrun.gap import Cause, FileCheck, JointDiagnosis, JudgedValue, OtherFit, RobotDiagnosis
from labrun.report.figures.gap_traces import traces_figure
from labrun.report.gap_page import parameter_table
from labrun.report.gap_words import HEADLINES, ranked, status_words, times_noise, value_words
from labrun.report.page import PageTable, drawn, render
from labrun.report.style import COLOURS, heading, new_figure
from labrun.report.text import aligned, listed, number, percent, short_time_text

_ALONE = {"no-gap": "none"}
"""What stands at a joint without a cause where the file's physics is enough."""
_OF_THE_WHOLE: Mapping[str, Mapping[str, str]] = {
    "gravity-tilt": {"roll": "rad", "pitch": "rad"},
    "gravity-compensation": {"share": "of all weights"},
    "payload": {"mass": "kg", "x": "m", "y": "m", "z": "m"},
}
"""Effects that the whole robot has and single joints tell, with units: at one joint their sizes are ratios."""


def cause_words(cause: Cause) -> str:
    """Return the name of a cause at a known joint, with its rivals."""
    text = cause.name.words.partition(" at ")[0]
    if cause.name.site.endswith("_command"):
        text += " of the command"
    same = [name.words for name in cause.indistinguishable_from]
    return text + (f" (or {listed(same, 'or')})" if same else "")


def moved_words(diagnosis: JointDiagnosis) -> str:
    """Return a sentence on parameters of a joint that are far from their stated values; "" if none."""
    return ", ".join(f"{name} {100 * (by - 1):+.2g} %" for name, by in diagnosis.moved.items())


def sizes_of(cause: Cause) -> str:
    """Return the sizes of the causes at a joint, with intervals and units."""
    units = _OF_THE_WHOLE.get(cause.name.effect, {})
    values = {name: replace(value, unit=units.get(name, value.unit)) for name, value in cause.values.items()}
    return "; ".join(value_words(values))


def size_lines(diagnosis: RobotDiagnosis) -> list[str]:
    """Return a line of sizes for each cause at each joint, and one for what the robot as a whole has."""
    lines = []
    for joint in diagnosis.joints:
        for cause in joint.diagnosis.causes:
            whole = cause.name.effect in _OF_THE_WHOLE
            text = f"{cause_words(cause)}, told by {joint.joint.name}" if whole else cause.name.words
            lines.append(f"{text}: {sizes_of(cause)}")
    return [*lines, *whole_lines(diagnosis)]


def whole_lines(diagnosis: RobotDiagnosis) -> list[str]:
    """Return a line of sizes for a tilt, a load and gravity compensation, as the whole robot has them."""
    lines = []
    for effect, _, values in diagnosis.whole:
        if units := _OF_THE_WHOLE.get(effect):
            sizes = ", ".join(f"{name} {number(value, 3)} {units[name]}" for name, value in values.items())
            where = ", in the frame of the last body" if "x" in values else ""
            lines.append(f"{effect.replace('-', ' ')} of the whole robot: {sizes}{where}")
    return lines


def joint_rows(robot: RobotDiagnosis) -> list[list[str]]:
    """Return joint, cause, confidence, gap recalibrated and with causes, and errors in the whole robot, as texts."""
    rows = []
    for joint in robot.joints:
        diagnosis, gap = joint.diagnosis, joint.diagnosis.gap
        alone = moved_words(joint) or _ALONE.get(diagnosis.verdict, HEADLINES[diagnosis.verdict])
        causes = " + ".join(cause_words(cause) for cause in diagnosis.causes) or alone
        confidence = ", ".join(percent(cause.confidence) for cause in diagnosis.causes)
        unit = joint.error_unit or joint.joint.unit
        errors = [
            f"{number(value, 2)} {unit}" for value in (joint.stated, joint.recalibrated, joint.corrected)
        ]
        after = times_noise(gap.after) if diagnosis.causes else ""
        rows.append([joint.joint.name, causes, confidence, times_noise(gap.recalibrated), after, *errors])
    return rows


def robot_lines(diagnosis: RobotDiagnosis, files: Mapping[str, Path] | None = None) -> list[str]:
    """Return the verdict, a line a joint, the sizes of what was found, and what was written."""
    heads = ["joint", "cause", "confidence", "gap", "with cause", "stated", "recalibrated", "corrected"]
    lines = [diagnosis.sentence, "", *aligned([heads, *joint_rows(diagnosis)])]
    sizes = size_lines(diagnosis)
    lines += ["", *sizes] if sizes else []
    lines += diagnosis.remarks
    joints = "joint" if len(diagnosis.joints) == 1 else "joints"
    lines.append(f"{len(diagnosis.joints)} {joints} in {short_time_text(diagnosis.seconds)}")
    return [*lines, *(f"{label}  {path}" for label, path in (files or {}).items())]


_CHECK_HEADS = ("joint", "stated", "corrected", "exported", "in the model", "in the file")


def _check_rows(check: FileCheck) -> list[list[str]]:
    return [
        [
            joint.joint,
            *(
                f"{number(value, 2)} {joint.unit}"
                for value in (joint.stated, joint.corrected, joint.exported)
            ),
            joint.corrected_as,
            joint.exported_as,
        ]
        for joint in check.joints
    ]


def file_check_lines(check: FileCheck) -> list[str]:
    """Return a line a joint: errors of the stated, corrected and exported robot on data that the fit has not seen."""
    heading = f"on {check.pieces} pieces of the log, each simulated by a fit that has not seen it:"
    whole = [
        f"the {kind} has {listed(written.of_the_whole, 'and')}"
        for kind, written in (("model", check.model), ("file", check.file))
        if written.of_the_whole
    ]
    return ["", heading, *aligned([list(_CHECK_HEADS), *_check_rows(check)]), *whole]


def other_fit_lines(fit: OtherFit) -> list[str]:
    """Return the errors of every joint by three models, then a line for each number that another tool found."""
    heads = ["joint", "as stated", "as fitted", "as diagnosed"]
    errors = [
        [
            joint.joint,
            *(f"{number(value, 2)} {joint.unit}" for value in (joint.stated, joint.fitted, joint.corrected)),
        ]
        for joint in fit.joints
    ]
    units = {joint.joint: joint.unit for joint in fit.joints}
    numbers = [
        [
            f"{value.fitted.element} {value.fitted.quantity}",
            "" if value.stated is None else number(value.stated, 3),
            number(value.fitted.value, 3),
            _judged_words(value, units),
        ]
        for value in fit.values
    ]
    lines = [*aligned([heads, *errors]), ""]
    lines += aligned([["number", "stated", "fitted", "the rule says"], *numbers]) if numbers else []
    return [*lines, *fit.remarks]


def _judged_words(value: JudgedValue, units: Mapping[str, str]) -> str:
    words = {
        "holds": "holds",
        "stands in": f"stands in for {value.instead}",
        "not asked for": "not asked for: as stated, the log is predicted no worse",
        "not applied": "not checked: the robot's model has no such number",
    }[value.judgement]
    if value.judgement in ("holds", "stands in") and value.fitted.element in units:
        words += f"; as stated, the error is {number(value.without, 2)} {units[value.fitted.element]}"
    return words + ("; at its bound" if value.fitted.at_bound else "")


_SHOWN = 12
_COLUMNS = (
    "joint", "cause", "confidence", "gap recalibrated", "gap with cause", "whole robot: stated", "recalibrated",
    "corrected",
)  # fmt: skip


def robot_page(diagnosis: RobotDiagnosis, check: FileCheck | None = None) -> str:
    """Return the page; the same diagnosis gives the same text, byte for byte."""
    rows = joint_rows(diagnosis)
    marked = [index for index, joint in enumerate(diagnosis.joints) if joint.diagnosis.causes or joint.moved]
    sections = [_section(joint) for joint in diagnosis.joints]
    return render(
        "robot.html.j2",
        {
            "title": f"{diagnosis.name}, joint by joint",
            "r": diagnosis,
            "whole": whole_lines(diagnosis),
            "links": [(limits["anchor"], limits["joint"]) for limits in sections],
            "picture": drawn(
                lambda: robot_figure(diagnosis), "robot", "Every joint's gap before and after its causes"
            ),
            "joints": PageTable(_COLUMNS, rows, words=(0, 1), marked=marked),
            "sections": sections,
            "check": None if check is None else PageTable(_CHECK_HEADS, _check_rows(check), words=(0, 4, 5)),
        },
    )


def _section(joint: JointDiagnosis) -> Mapping[str, Any]:
    diagnosis = joint.diagnosis
    lines = [f"{cause_words(cause)}: {sizes_of(cause)}" for cause in diagnosis.causes]
    for cause in diagnosis.causes:
        rivals = listed([name.words for name in cause.indistinguishable_from], "or")
        lines += [f"These data cannot tell {cause.name.words} from {rivals}."] if rivals else []
    candidates = [
        [
            other.name.words, status_words(other), "" if other.closes is None else percent(other.closes),
            "; ".join(value_words(other.values)),
        ]
        for other in ranked(diagnosis.candidates)[:_SHOWN]
    ]  # fmt: skip
    return {
        "anchor": f"joint-{joint.joint.output}",
        "joint": joint.joint.name,
        "d": diagnosis,
        "lines": lines,
        "traces": drawn(
            lambda: traces_figure(diagnosis), f"traces-{joint.joint.output}", "Measured and simulated"
        ),
        "candidates": PageTable(("candidate", "status", "closes alone", "size"), candidates, words=(0, 1, 3)),
        "parameters": parameter_table(diagnosis),
    }


_WIDTH_IN, _JOINT_IN, _AROUND_IN = 9.4, 0.42, 1.6
_AS_STATED = "#c3c7cd"


def robot_figure(diagnosis: RobotDiagnosis) -> Figure:
    """Draw a row a joint: the gap as recalibrated and with the causes, in units of the noise, on a log scale."""
    count = len(diagnosis.joints)
    with new_figure(_WIDTH_IN, _AROUND_IN + _JOINT_IN * count) as figure:
        heading(figure, f"{diagnosis.name}: joint by joint", diagnosis.sentence)
        axes = figure.subplots()
        for row, joint in enumerate(diagnosis.joints):
            gap = joint.diagnosis.gap
            before, after = max(gap.recalibrated, 0.05), max(gap.after, 0.05)
            axes.plot([max(gap.raw, 0.05), before], [row, row], color=_AS_STATED, lw=2, zorder=1)
            if joint.diagnosis.causes:
                axes.plot([before, after], [row, row], color=COLOURS[0], lw=5, alpha=0.35, zorder=2)
                axes.plot(after, row, "o", color=COLOURS[0], zorder=3)
                causes = joint.diagnosis.causes
                named = ", ".join(
                    f"{cause.name.words.partition(' at ')[0]} ({percent(cause.confidence)})"
                    for cause in causes
                )
                axes.annotate(
                    named,
                    (max(gap.raw, before), row),
                    (8, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize=9,
                )
            axes.plot(before, row, "o", mfc="white", mec=COLOURS[0], zorder=3)
        axes.axvline(1.0, color=_AS_STATED, lw=1, ls="--", zorder=0)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        low, high = axes.get_xlim()
        axes.set_xlim(low, high * 12)
        axes.set_yticks(range(count), [joint.joint.name for joint in diagnosis.joints])
        axes.invert_yaxis()
        axes.set_xlabel("gap in units of one trial's noise: open, recalibrated; filled, with the cause")
    return figure
