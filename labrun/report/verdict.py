"""What a run came to, and what speaks for and against believing it, in sentences."""

import math
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtrit

from labrun.report.conditions import varying
from labrun.report.report_source import ReportSource
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
from labrun.spec import condition_key

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


def what_was_run(source: ReportSource) -> str:
    """Return what was run and how much of the bench's time it took, in a sentence or two."""
    run, kind = source.run, _KINDS.get(source.experiment.kind, source.experiment.kind)
    conditions = {condition_key(outcome.condition) for outcome in run.outcomes if outcome.role != "reference"}
    trials = f"{counted(len(run.outcomes), 'trial')} at {counted(len(conditions), 'condition')}"
    if source.imported:
        return f"A recording made elsewhere, imported: {trials}, {duration_text(source.bench_time_s)} of samples."
    spoiled = len(source.spoiled)
    accepted = "all accepted" if not spoiled else f"{len(source.accepted)} accepted"
    text = f"This {kind} took {trials} in {duration_text(source.bench_time_s)} of bench time; {accepted}."
    if not run.outcomes:
        text = f"This {kind} has no trial yet."
    if source.dry_run:
        wall = source.wall_time_s
        took = f", in {duration_text(wall)} of computing" if wall is not None else ""
        text += f" It was a dry run: the bench is simulated{took}."
    elif source.emulated:
        text += " It was emulated: the real drivers, in front of a simulated bench."
    return text


def what_came_out(source: ReportSource) -> str:
    """Return what a run without an honest best measured, in a sentence."""
    experiment = source.experiment
    if not source.accepted:
        return "No trial was accepted, so there is nothing to conclude yet."
    goal = experiment.goal
    if goal is not None:
        points = source.points(goal[0])
        if not points:
            return f"No accepted trial has a value of {goal[0]} yet."
        choose = max if goal[1] == "maximise" else min
        top = choose(points, key=lambda point: point.mean)
        return (
            f"No best can be named yet: the leaders were not measured again. The most promising mean so far is "
            f"{goal[0]} = {quantity_text(top.mean, source.unit)} ({counted(len(top.values), 'trial')}) at "
            f"{named_condition(top.condition, experiment.units)}; being picked from {len(points)}, it is likely "
            "too good."
        )
    sentences = [text for name in experiment.objectives if (text := _range(source, name))]
    if sentences:
        return " ".join(sentences)
    channels = sum(len(signals.columns) for signals in source.run.signals(source.accepted[0].index).values())
    if not channels:
        return "It declares no objective and recorded no channel: there is nothing to draw."
    return f"It declares no objective: what it measured is the signals of {counted(channels, 'channel')}, shown below."


def checks(source: ReportSource) -> list[Check]:
    """Return what decides whether the run can be believed, in the order of the sections."""
    if not source.run.outcomes:
        return []
    found = [*_noise(source), *_steadiness(source), *_rest(source), *_sampling(source), *_losses(source)]
    return [check for check in found if not (source.imported and check.verdict == "open")]


def _noise(source: ReportSource) -> list[Check]:
    name = source.objective
    if name is None:
        return []
    item = next((item for item in source.repeatability if item.objective == name), None)
    if item is None:
        return [
            Check("repeatability", "open", "No condition was repeated: the noise of a trial is not known.")
        ]
    text = f"Single trials of one condition scatter by {scatter_text(item.sd, item.unit)} (sd)"
    if item.between_sd is None or item.between_sd == 0:
        return [Check("repeatability", "good", f"{text}.")]
    ratio = item.sd / item.between_sd
    text += f", {share_text(ratio, 1.0)} of the sd between conditions."
    return [Check("repeatability", "good" if ratio < 1 else "look", text)]


def _steadiness(source: ReportSource) -> list[Check]:
    if not source.experiment.objectives:
        return []
    if not source.drift:
        return [Check("drift", "open", "Fewer than three reference trials: drift of the bench is not known.")]
    visible = [item.objective for item in source.drift if item.visible]
    if visible:
        return [Check("drift", "look", f"The reference trials drift in {', '.join(visible)}.")]
    trials = counted(max(item.trials for item in source.drift), "reference trial")
    item = next((item for item in source.drift if item.objective == source.objective), source.drift[0])
    hidden, sd = most_hidden(source, item), source.sd_of(item.objective)
    limit = f"they exclude more than {scatter_text(hidden, item.unit)} over the run"
    if sd and hidden > _HIDDEN * sd:
        times = f"{hidden / sd:.0f} times the scatter of a trial"
        text = f"No drift visible, but {trials} can hardly tell: {limit}, {times}."
        return [Check("drift", "open", text)]
    return [Check("drift", "good", f"No drift visible in {trials}: {limit}.")]


def _rest(source: ReportSource) -> list[Check]:
    settled = [outcome.settle for outcome in source.run.outcomes if outcome.settle is not None]
    if not settled:
        return [Check("settling", "open", "The experiment does not wait for the bench to come to rest.")]
    late = sum(summary.reason == "timeout" for summary in settled)
    if late:
        text = f"Before {counted(late, 'trial')} of {len(settled)} the bench did not come to rest in time."
        return [Check("settling", "look", text)]
    if all(summary.reason == "time" for summary in settled):
        return [
            Check(
                "settling",
                "open",
                "The bench was given a fixed time to settle; nobody looked whether it had.",
            )
        ]
    return [Check("settling", "good", f"The bench was at rest before all {len(settled)} trials.")]


def _sampling(source: ReportSource) -> list[Check]:
    bad = [
        f"{item.device} lost {share_text(item.lost_share, 1.0)} of its samples, {item.saturated} were saturated"
        for item in source.streams
        if item.lost_share > _LOST or item.saturated
    ]
    bad += [
        f"{item.device} ran at {item.actual_hz:.4g} Hz instead of {item.nominal_hz:.4g} Hz"
        for item in source.streams
        if item.nominal_hz and abs(item.actual_hz / item.nominal_hz - 1) > _RATE_OFF
    ]
    if bad:
        return [Check("timing", "look", f"{'; '.join(bad)}.")]
    if not source.streams:
        return []
    of = f"in the {counted(len(source.streams_looked_at), 'trial')} that were looked at"
    lost = max(item.lost_share for item in source.streams)
    if lost:
        text = f"At most {share_text(lost, 1.0)} of a device's samples lost {of}, none saturated."
        return [Check("timing", "good", text)]
    return [Check("timing", "good", f"No sample lost or saturated {of}.")]


def _losses(source: ReportSource) -> list[Check]:
    spoiled, total = len(source.spoiled), len(source.run.outcomes)
    if not spoiled:
        return [Check("rejected", "good", f"All {counted(total, 'trial')} accepted.")]
    failed = sum(outcome.status == "failed" for outcome in source.spoiled)
    of = f"{counted(total, 'trial')} ({share_text(spoiled, total)})"
    text = f"{spoiled - failed} rejected and {failed} failed of {of}."
    return [Check("rejected", "look" if failed or spoiled > _MOST_SPOILED * total else "good", text)]


def _range(source: ReportSource, objective: str) -> str:
    points = source.points(objective)
    if not points:
        return ""
    unit, name = source.unit_of(objective), spaced(objective)
    if len(points) == 1:
        value, interval = interval_words(points[0].mean, points[0].ci95, unit)
        certain = (
            f" (95 % interval {interval}, {len(points[0].values)} trials)" if interval else " (one trial)"
        )
        return f"Measured {name}: {value}{certain}."
    low, high = (choose(points, key=lambda point: point.mean) for choose in (min, max))
    units = source.experiment.units
    differing = varying(point.condition for point in points)
    lowest, highest = (
        named_condition({n: v for n, v in point.condition.items() if n in differing}, units)
        for point in (low, high)
    )
    return (
        f"Mean {name} goes from {quantity_text(low.mean, unit)} at {lowest} to "
        f"{quantity_text(high.mean, unit)} at {highest}."
    )


def why_unfinished(source: ReportSource) -> str:
    """Return why a run that is not finished came to a stop; "" where nobody noted it."""
    ends = ("interrupted", "failed", "limit-reached")
    last = next((event for event in reversed(source.run.events) if event["event"] in ends), None)
    if last is None:
        return ""
    if last["event"] == "limit-reached":
        return f"It stopped as asked, after {last.get('limit')} new trials."
    return f"It last ended with: {last.get('reason', last['event'])}."


def why_it_went_on(found: Settling) -> str:
    """Return why waiting for the bench to come to rest ended, over all trials."""
    total = sum(found.reasons.values())
    if set(found.reasons) == {"quiet"}:
        return f"Before all {counted(total, 'trial')} the bench was quiet."
    if set(found.reasons) == {"time"}:
        return f"{counted(total, 'trial')} began after a fixed time; whether the bench was at rest was not looked at."
    words = {
        "quiet": "the bench was quiet",
        "timeout": "time was up and the bench still moving",
        "time": "a fixed time",
    }
    parts = [
        f"{words.get(reason, reason)} before {count} ({share_text(count, total)})"
        for reason, count in found.reasons.items()
    ]
    return f"Of {counted(total, 'trial')}: {', '.join(parts)}."


def drift_sentence(source: ReportSource, item: Drift) -> str:
    """Return what the reference trials say of one objective: how fast it drifts, or how much drift could hide."""
    hours = _hours(source)
    slope = slope_words(item.slope_per_h, item.ci95, item.unit)
    sd = source.sd_of(item.objective)
    name = spaced(item.objective)
    if item.visible:
        change = item.slope_per_h * hours
        text = (
            f"{name} drifts: {slope} by {counted(item.trials, 'reference trial')}, "
            f"{scatter_text(change, item.unit)} over the run's {hours:.2g} h"
        )
        text += f", {abs(change) / sd:.2g} times the scatter of a single trial." if sd else "."
        return capital(text)
    most = most_hidden(source, item)
    text = (
        f"{name} shows no drift: {slope} by {counted(item.trials, 'reference trial')}. "
        f"Up to {scatter_text(most, item.unit)} over the run's {hours:.2g} h could hide in that"
    )
    text += f"; a single trial scatters by {scatter_text(sd, item.unit)}." if sd else "."
    return capital(text)


def most_hidden(source: ReportSource, item: Drift) -> float:
    """Return how far the bench may have drifted over the whole run without the references showing it."""
    return max(abs(end) for end in item.ci95) * _hours(source)


def what_it_resolves(source: ReportSource, item: Repeatability) -> str:
    """Return how noisy a trial is, and how far apart two conditions must be to differ beyond chance."""
    means, sds, counts = spreads(source, item.objective)
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


def _hours(source: ReportSource) -> float:
    starts = [outcome.started_s for outcome in source.run.outcomes]
    return (max(starts) - min(starts)) / 3600
