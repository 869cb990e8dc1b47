"""Sentences on the result of a run, and on its reliability."""

import math
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtrit

from labrun.experiment import condition_key, varying
from labrun.report.findings import Findings
from labrun.report.statistics import Drift, Repeatability, Settling, grows_with_size, spreads
from labrun.report.text import (
    capital,
    counted,
    duration_text,
    interval_words,
    named_condition,
    quantity_text,
    scatter_text,
    share_text,
    slope_words,
    spaced,
)

_KINDS = {
    "run": "run",
    "sweep": "sweep",
    "cmaes": "CMA-ES search",
    "track": "tracking run",
    "design": "design",
}
_HIDDEN = 3.0
"""Drift of more than so many sd of a trial, hidden in the references' interval, is too much to call them steady."""
_MOST_SPOILED = 0.05
_RATE_OFF = 0.05
_LOST = 1e-3


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that decides whether a run can be believed.

    Attributes
    ----------
    anchor
        Section that tells more.
    verdict
        "good", "look" (a person should look) or "open" (the run cannot tell).
    text
        In a sentence.
    """

    anchor: str
    verdict: Literal["good", "look", "open"]
    text: str


def what_was_run(findings: Findings) -> str:
    """Return one or two sentences on what was run and the bench time it took."""
    run, kind = findings.run, _KINDS.get(findings.experiment.kind, findings.experiment.kind)
    conditions = {condition_key(outcome.condition) for outcome in run.outcomes if outcome.role != "reference"}
    trials = f"{counted(len(run.outcomes), 'trial')} at {counted(len(conditions), 'condition')}"
    if findings.imported:
        return f"A recording made elsewhere, imported: {trials}, {duration_text(findings.bench_time_s)} of samples."
    if findings.simulated_only:
        if not run.outcomes:
            return "This design is simulated, and has no leader yet."
        return (
            f"This design was searched for by simulation. Then {counted(len(conditions), 'leader')} of the search "
            f"{'was' if len(conditions) == 1 else 'were'} simulated again, as "
            f"{counted(len(run.outcomes), 'copy')} whose dimensions lie anywhere within their tolerances."
        )
    spoiled = len(findings.spoiled)
    accepted = "all accepted" if not spoiled else f"{len(findings.accepted)} accepted"
    text = f"This {kind} took {trials} in {duration_text(findings.bench_time_s)} of bench time; {accepted}."
    if not run.outcomes:
        text = f"This {kind} has no trial yet."
    if findings.dry_run:
        wall = findings.wall_time_s
        took = f", in {duration_text(wall)} of computing" if wall is not None else ""
        text += f" It was a dry run: the bench is simulated{took}."
    elif findings.emulated:
        text += " It was emulated: the real drivers, in front of a simulated bench."
    return text


def what_came_out(findings: Findings) -> str:
    """Return a sentence on the measurements of a run without a confirmed best."""
    experiment = findings.experiment
    if not findings.accepted:
        return "No trial was accepted, so nothing can be concluded yet."
    goal = experiment.goal
    if goal is not None:
        points = findings.points(goal[0])
        if not points:
            return f"No accepted trial has a value of {goal[0]} yet."
        choose = max if goal[1] == "maximise" else min
        top = choose(points, key=lambda point: point.mean)
        return (
            f"No best can be named yet: the leaders were not measured again. The most promising mean so far is "
            f"{goal[0]} = {quantity_text(top.mean, findings.unit)} ({counted(len(top.values), 'trial')}) at "
            f"{named_condition(top.condition, experiment.units)}; being picked from {len(points)}, it is likely "
            "too good."
        )
    sentences = [text for name in experiment.objectives if (text := _range(findings, name))]
    if sentences:
        return " ".join(sentences)
    channels = sum(
        len(signals.columns) for signals in findings.run.signals(findings.accepted[0].index).values()
    )
    if not channels:
        return "It declares no objective and recorded no channel, so nothing can be plotted."
    return f"It declares no objective: what it measured is the signals of {counted(channels, 'channel')}, shown below."


def checks(findings: Findings) -> list[Check]:
    """Return what decides whether the run can be believed, in the order of the sections."""
    if not findings.run.outcomes:
        return []
    if findings.simulated_only:
        return [_losses(findings)] if findings.spoiled else []
    findings_of = [check(findings) for check in (_noise, _steadiness, _rest, _sampling, _losses)]
    return [
        verdict
        for verdict in findings_of
        if verdict is not None and not (findings.imported and verdict.verdict == "open")
    ]


def _noise(findings: Findings) -> Check | None:
    name = findings.objective
    if name is None:
        return None
    item = next((item for item in findings.repeatability if item.objective == name), None)
    if item is None:
        return Check("repeatability", "open", "No condition was repeated: the noise of a trial is not known.")
    text = f"Single trials of one condition scatter by {scatter_text(item.sd, item.unit)} (sd)"
    if item.between_sd is None or item.between_sd == 0:
        return Check("repeatability", "good", f"{text}.")
    ratio = item.sd / item.between_sd
    text += f", {share_text(ratio, 1.0)} of the sd between conditions."
    return Check("repeatability", "good" if ratio < 1 else "look", text)


def _steadiness(findings: Findings) -> Check | None:
    if not findings.experiment.objectives:
        return None
    if not findings.drift:
        return Check("drift", "open", "Fewer than three reference trials: drift of the bench is not known.")
    visible = [item.objective for item in findings.drift if item.visible]
    if visible:
        return Check("drift", "look", f"The reference trials drift in {', '.join(visible)}.")
    trials = counted(max(item.trials for item in findings.drift), "reference trial")
    item = next((item for item in findings.drift if item.objective == findings.objective), findings.drift[0])
    hidden, sd = most_hidden(findings, item), findings.sd_of(item.objective)
    limit = f"they exclude more than {scatter_text(hidden, item.unit)} over the run"
    if sd and hidden > _HIDDEN * sd:
        times = f"{hidden / sd:.0f} times the scatter of a trial"
        text = f"No drift visible, but {trials} can hardly tell: {limit}, {times}."
        return Check("drift", "open", text)
    return Check("drift", "good", f"No drift visible in {trials}: {limit}.")


def _rest(findings: Findings) -> Check | None:
    settled = [outcome.settle for outcome in findings.run.outcomes if outcome.settle is not None]
    if not settled:
        return Check("settling", "open", "The experiment does not wait for the bench to come to rest.")
    late = sum(summary.reason == "timeout" for summary in settled)
    if late:
        text = f"Before {counted(late, 'trial')} of {len(settled)} the bench did not come to rest in time."
        return Check("settling", "look", text)
    if all(summary.reason == "time" for summary in settled):
        return Check(
            "settling", "open", "The bench was given a fixed time to settle; nobody looked whether it had."
        )
    return Check("settling", "good", f"The bench was at rest before all {len(settled)} trials.")


def _sampling(findings: Findings) -> Check | None:
    bad = [
        f"{item.device} lost {share_text(item.lost_share, 1.0)} of its samples, {item.saturated} were saturated"
        for item in findings.streams
        if item.lost_share > _LOST or item.saturated
    ]
    bad += [
        f"{item.device} ran at {item.actual_hz:.4g} Hz instead of {item.nominal_hz:.4g} Hz"
        for item in findings.streams
        if item.nominal_hz and abs(item.actual_hz / item.nominal_hz - 1) > _RATE_OFF
    ]
    if bad:
        return Check("timing", "look", f"{'; '.join(bad)}.")
    if not findings.streams:
        return None
    of = f"in the {counted(len(findings.streams_looked_at), 'trial')} that were looked at"
    lost = max(item.lost_share for item in findings.streams)
    if lost:
        text = f"At most {share_text(lost, 1.0)} of a device's samples lost {of}, none saturated."
        return Check("timing", "good", text)
    return Check("timing", "good", f"No sample lost or saturated {of}.")


def _losses(findings: Findings) -> Check:
    spoiled, total = len(findings.spoiled), len(findings.run.outcomes)
    if not spoiled:
        return Check("rejected", "good", f"All {counted(total, 'trial')} accepted.")
    failed = sum(outcome.status == "failed" for outcome in findings.spoiled)
    of = f"{counted(total, 'trial')} ({share_text(spoiled, total)})"
    text = f"{spoiled - failed} rejected and {failed} failed of {of}."
    return Check("rejected", "look" if failed or spoiled > _MOST_SPOILED * total else "good", text)


def _range(findings: Findings, objective: str) -> str:
    points = findings.points(objective)
    if not points:
        return ""
    unit, name = findings.unit_of(objective), spaced(objective)
    if len(points) == 1:
        value, interval = interval_words(points[0].mean, points[0].ci95, unit)
        certain = (
            f" (95 % interval {interval}, {len(points[0].values)} trials)" if interval else " (one trial)"
        )
        return f"Measured {name}: {value}{certain}."
    low, high = (choose(points, key=lambda point: point.mean) for choose in (min, max))
    units = findings.experiment.units
    differing = varying(point.condition for point in points)
    lowest, highest = (
        named_condition({n: v for n, v in point.condition.items() if n in differing}, units)
        for point in (low, high)
    )
    return (
        f"Mean {name} goes from {quantity_text(low.mean, unit)} at {lowest} to "
        f"{quantity_text(high.mean, unit)} at {highest}."
    )


def why_unfinished(findings: Findings) -> str:
    """Return why an unfinished run stopped; "" if not recorded."""
    ends = ("interrupted", "failed", "limit-reached")
    last = next((event for event in reversed(findings.run.events) if event["event"] in ends), None)
    if last is None:
        return ""
    if last["event"] == "limit-reached":
        return f"It stopped as asked, after {last.get('limit')} new trials."
    return f"It last ended with: {last.get('reason', last['event'])}."


def why_it_went_on(settling: Settling) -> str:
    """Return why waiting for the bench to come to rest ended, over all trials."""
    total = sum(settling.reasons.values())
    if set(settling.reasons) == {"quiet"}:
        return f"Before all {counted(total, 'trial')} the bench was quiet."
    if set(settling.reasons) == {"time"}:
        return f"{counted(total, 'trial')} began after a fixed time; whether the bench was at rest was not looked at."
    words = {
        "quiet": "the bench was quiet",
        "timeout": "time was up and the bench still moving",
        "time": "a fixed time",
    }
    parts = [
        f"{words.get(reason, reason)} before {count} ({share_text(count, total)})"
        for reason, count in settling.reasons.items()
    ]
    return f"Of {counted(total, 'trial')}: {', '.join(parts)}."


def drift_sentence(findings: Findings, item: Drift) -> str:
    """Return what the reference trials say of one objective: how fast it drifts, or how much drift could hide."""
    hours = _hours(findings)
    slope = slope_words(item.slope_per_h, item.ci95, item.unit)
    sd = findings.sd_of(item.objective)
    name = spaced(item.objective)
    if item.visible:
        change = item.slope_per_h * hours
        text = (
            f"{name} drifts: {slope} by {counted(item.trials, 'reference trial')}, "
            f"{scatter_text(change, item.unit)} over the run's {hours:.2g} h"
        )
        text += f", {abs(change) / sd:.2g} times the scatter of a single trial." if sd else "."
        return capital(text)
    most = most_hidden(findings, item)
    text = (
        f"{name} shows no drift: {slope} by {counted(item.trials, 'reference trial')}. "
        f"Up to {scatter_text(most, item.unit)} over the run's {hours:.2g} h could hide in that"
    )
    text += f"; a single trial scatters by {scatter_text(sd, item.unit)}." if sd else "."
    return capital(text)


def most_hidden(findings: Findings, item: Drift) -> float:
    """Return how far the bench may have drifted over the whole run without the references showing it."""
    return max(abs(end) for end in item.ci95) * _hours(findings)


def what_it_resolves(findings: Findings, item: Repeatability) -> str:
    """Return how noisy a trial is, and how far apart two conditions must be to differ beyond chance."""
    means, sds, counts = spreads(findings, item.objective)
    repeats = round(float(sorted(counts.tolist())[len(counts) // 2]))
    least = float(stdtrit(item.degrees_of_freedom, 0.975)) * item.sd * math.sqrt(2 / repeats)
    text = (
        f"A single trial of {spaced(item.objective)} scatters by {scatter_text(item.sd, item.unit)} (sd, pooled over "
        f"{counted(len(means), 'condition')}), a mean of {repeats} by "
        f"{scatter_text(item.sd / math.sqrt(repeats), item.unit)}. Two given conditions with {repeats} trials each "
        f"differ beyond chance (95 %) when their means are more than {scatter_text(least, item.unit)} apart."
    )
    correlation = grows_with_size(means, sds)
    if correlation is not None:
        kind = "larger" if correlation > 0 else "smaller"
        text += (
            f" The scatter is {kind} where the value is larger (rank correlation {correlation:.2f}), so the pooled sd "
            "stands for the middle of the range only."
        )
    return text


def _hours(findings: Findings) -> float:
    starts = [outcome.started_s for outcome in findings.run.outcomes]
    return (max(starts) - min(starts)) / 3600
