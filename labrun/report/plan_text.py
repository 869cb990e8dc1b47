"""What `labrun check` prints."""

import shutil
from pathlib import Path

from labrun.report.text import duration_text
from labrun.runner import JointPeak, Plan, percent

_NO_LIMIT = "no limit set"
_NAMED = 6
"""Of the constraints and limits that exclude part of a search space, so many are named."""


def plan_text(plan: Plan, results: Path) -> str:
    """Return a plan as a person reads it: trials, time, disk, and every joint's demand beside its limits.

    Parameters
    ----------
    plan
        Of `labrun.runner.Planner`.
    results
        Where runs will be written; its disk's free space stands beside what the run needs.
    """
    folder = next(path for path in (results, *results.absolute().parents) if path.is_dir())
    free = shutil.disk_usage(folder).free
    rates = ", ".join(f"{name} {rate:g} Hz" for name, rate in plan.rates_hz.items())
    lines = [
        *_what_is_measured(plan),
        f"trials      {_between(str(plan.trials), str(plan.trials_at_most))}",
        f"time        {_between(duration_text(plan.time_s), duration_text(plan.time_at_most_s))} on the bench, "
        f"{_settling(plan)}",
        f"disk        {size(plan.disk_bytes)} of {size(free)} free",
        f"sensors     {rates or 'none'}",
    ]
    lines += [f"joint       {_joint(peak)}" for peak in plan.peaks]
    lines += [f"note        {note}" for note in plan.notes]
    if plan.excess:
        lines.append(f"limits      {len(plan.excess)} of {plan.conditions} conditions leave a limit")
    elif plan.space is None:
        lines.append("limits      all conditions stay inside")
    return "\n".join(lines)


def _what_is_measured(plan: Plan) -> list[str]:
    space = plan.space
    if space is None:
        return [f"conditions  {plan.conditions}"]
    lines = [
        f"search      about {percent(space.share)} of the search space may run ({space.points:,} points looked at)"
    ]
    lines += [f"            {item}" for item in space.breaks[:_NAMED]]
    if len(space.breaks) > _NAMED:
        lines.append(f"            and {len(space.breaks) - _NAMED} more")
    if space.start:
        lines.append(f"start       the search starts where it may not run: {'; '.join(space.start)}")
    return lines


def _settling(plan: Plan) -> str:
    if plan.settle_s == plan.settle_at_most_s:
        return f"counting {plan.settle_s:g} s of settling a trial"
    return (
        f"counting {plan.settle_s:g} s of settling a trial (the least that evidence takes) to "
        f"{plan.settle_at_most_s:g} s (its timeout)"
    )


def size(count: float) -> str:
    """Return a number of bytes in a unit that suits it."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def _between(least: str, most: str) -> str:
    return least if least == most else f"{least} to {most}"


def _joint(peak: JointPeak) -> str:
    low, high = peak.angle_deg
    angle = f"{low:.4g} to {high:.4g} deg"
    limit = peak.angle_limit_deg
    angle += f" ({_NO_LIMIT})" if limit is None else f" (limit {limit[0]:g} to {limit[1]:g})"
    speed = f"{peak.speed_deg_s:.4g} deg/s"
    speed_limit = peak.speed_limit_deg_s
    speed += f" ({_NO_LIMIT})" if speed_limit is None else f" (limit {speed_limit:g})"
    name = peak.joint if peak.joint == peak.device else f"{peak.joint} of {peak.device}"
    return f"{name}: {angle}, at most {speed}"
