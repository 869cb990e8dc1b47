"""What `labrun check` prints."""

import shutil
from pathlib import Path

from labrun.runner.plan import JointPeak, Plan


def plan_text(plan: Plan, results: Path) -> str:
    """Return a plan as a person reads it: trials, time, disk, and every joint's demand beside its limits.

    Parameters
    ----------
    plan
        Of `labrun.runner.plan.plan`.
    results
        Where runs will be written; its disk's free space stands beside what the run needs.
    """
    folder = next(path for path in (results, *results.absolute().parents) if path.is_dir())
    free = shutil.disk_usage(folder).free
    rates = ", ".join(f"{name} {rate:g} Hz" for name, rate in plan.rates_hz.items())
    lines = [
        f"conditions  {plan.conditions}",
        f"trials      {_between(str(plan.trials), str(plan.trials_at_most))}",
        f"time        {_between(duration(plan.time_s), duration(plan.time_at_most_s))} on the bench, "
        f"counting {plan.settle_s:g} s of settling a trial",
        f"disk        {size(plan.disk_bytes)} of {size(free)} free",
        f"sensors     {rates or 'none'}",
    ]
    lines += [f"joint       {_joint(peak)}" for peak in plan.peaks]
    if plan.excess:
        lines.append(f"limits      {len(plan.excess)} of {plan.conditions} conditions leave a limit")
    else:
        lines.append("limits      all conditions stay inside")
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """Return a time in the two units that matter."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    if days:
        return f"{days} d {hours} h"
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


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
    if peak.angle_limit_deg is not None:
        angle += f" (limit {peak.angle_limit_deg[0]:g} to {peak.angle_limit_deg[1]:g})"
    speed = f"{peak.speed_deg_s:.4g} deg/s"
    if peak.speed_limit_deg_s is not None:
        speed += f" (limit {peak.speed_limit_deg_s:g})"
    name = peak.joint if peak.joint == peak.device else f"{peak.joint} of {peak.device}"
    return f"{name}: {angle}, at most {speed}"
