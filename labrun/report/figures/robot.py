"""The picture of a robot's diagnosis: every joint, how far its gap closes, and what was named there."""

from matplotlib.figure import Figure

from labrun.gap import RobotDiagnosis
from labrun.report.style import COLOURS, heading, new_figure
from labrun.report.text import percent

_WIDTH_IN, _JOINT_IN, _AROUND_IN = 9.4, 0.42, 1.6
_AS_STATED = "#c3c7cd"


def robot_figure(found: RobotDiagnosis) -> Figure:
    """Draw a row a joint: the gap as recalibrated and with the causes, in units of the noise, on a log scale."""
    count = len(found.joints)
    with new_figure(_WIDTH_IN, _AROUND_IN + _JOINT_IN * count) as figure:
        heading(figure, f"{found.name}: joint by joint", found.sentence)
        axes = figure.subplots()
        for row, one in enumerate(found.joints):
            gap = one.diagnosis.gap
            before, after = max(gap.recalibrated, 0.05), max(gap.after, 0.05)
            axes.plot([max(gap.raw, 0.05), before], [row, row], color=_AS_STATED, lw=2, zorder=1)
            if one.diagnosis.causes:
                axes.plot([before, after], [row, row], color=COLOURS[0], lw=5, alpha=0.35, zorder=2)
                axes.plot(after, row, "o", color=COLOURS[0], zorder=3)
                causes = one.diagnosis.causes
                named = ", ".join(
                    f"{one.name.words.partition(' at ')[0]} ({percent(one.confidence)})" for one in causes
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
        axes.set_yticks(range(count), [one.joint.name for one in found.joints])
        axes.invert_yaxis()
        axes.set_xlabel("gap in units of one trial's noise: open, recalibrated; filled, with the cause")
    return figure
