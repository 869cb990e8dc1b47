"""Trials before any data, as people read them: what they would show, from which size on, and what none can."""

from labrun.gap.next import TrialPlan
from labrun.report.text import (
    aligned,
    condition_text,
    counted,
    duration_text,
    listed,
    number,
    spaced,
    unit_text,
)


def plan_text(found: TrialPlan) -> str:
    """Return the trials, then a line for every effect."""
    seen = [one for one in found.visible if one.size is not None]
    lines = [
        f"{counted(len(found.trials), 'trial')}, {counted(found.repeats, 'repeat')} of each, about "
        f"{duration_text(found.time_s)} of rig time, of {counted(found.looked_at, 'trial')} inside the limits: "
        f"{len(seen)} of {counted(len(found.visible), 'effect')} would be visible"
    ]
    lines += [
        f"trial {place}  {condition_text(one.condition)}" for place, one in enumerate(found.trials, start=1)
    ]
    noise = ", ".join(
        f"{spaced(name)} {number(one.value)} {unit_text(one.unit)}".rstrip()
        for name, one in found.noise.items()
    )
    lines.append(f"noise    {noise} (standard deviation of one trial)")
    rows = [["visible from", "", "best in", "but looks like"]]
    for one in seen:
        size = one.size
        if size is not None:
            words = f"{spaced(one.parameter)} {number(size.value)} {unit_text(size.unit)}".rstrip()
            alike = [name.words for name in one.alike]
            rows.append([one.name.words, words, f"trial {one.best + 1}", listed(alike, "or")])
    lines += aligned(rows) if seen else []
    hidden = [one for one in found.visible if one.size is None]
    if hidden:
        lines += aligned([["not visible in any of them", ""], *[[one.name.words, one.why] for one in hidden]])
    lines += [f"note: {one}" for one in found.notes]
    if found.file is not None:
        lines += [f"wrote    {found.file}", f"next     labrun run {found.file}"]
    return "\n".join(lines)
