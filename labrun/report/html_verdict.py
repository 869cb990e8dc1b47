"""The top of a report: what was run, what came out, and what speaks for and against believing it."""

from dataclasses import dataclass
from typing import Literal

from labrun.report.conditions import varying
from labrun.report.html_elements import Content, Html, element, joined, paragraph
from labrun.report.html_trust import most_hidden
from labrun.report.report_source import ReportSource
from labrun.report.stored_fits import stored_fits
from labrun.report.text import (
    counted,
    duration_text,
    interval_words,
    named_condition,
    quantity_text,
    scatter_text,
    share_text,
    spaced,
)
from labrun.search.result import Best, resume_line
from labrun.spec import condition_key

_KINDS = {
    "run": "run",
    "sweep": "sweep",
    "cmaes": "CMA-ES search",
    "track": "tracking run",
    "design": "design",
}
_MARKS = {"good": "\u2713", "look": "!", "open": "?"}
_TOPICS = {"repeatability": "noise", "timing": "streams", "rejected": "trials"}
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


def head(source: ReportSource) -> Html:
    """Return title, where the run is, the verdict and the checks."""
    run = source.run
    folder = run.path if source.folder is None else source.folder
    items = [_check(check) for check in checks(source)]
    return joined(
        [
            element("h1", source.experiment.title),
            paragraph(f"{run.name}, run {run.identifier}, in ", element("code", str(folder)), class_="where"),
            _unfinished(source),
            *(paragraph(f"Damaged on disk: {fault}", class_="stop") for fault in run.faults),
            paragraph(what_was_run(source), class_="lead"),
            _best(source, source.best) if source.best is not None else paragraph(what_came_out(source)),
            _fitted(source),
            element("ul", *items, class_="checks") if items else None,
        ]
    )


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
    view, experiment = source.view, source.experiment
    if not source.accepted:
        return "No trial was accepted, so there is nothing to conclude yet."
    goal = experiment.goal
    if goal is not None:
        points = view.points(goal[0])
        if not points:
            return f"No accepted trial has a value of {goal[0]} yet."
        choose = max if goal[1] == "maximise" else min
        top = choose(points, key=lambda point: point.mean)
        return (
            f"No best can be named yet: the leaders were not measured again. The most promising mean so far is "
            f"{goal[0]} = {quantity_text(top.mean, view.unit)} ({counted(len(top.values), 'trial')}) at "
            f"{named_condition(top.condition, experiment.units)}; being picked from {len(points)}, it is likely "
            "too good."
        )
    sentences = [text for name in experiment.objectives if (text := _range(source, name))]
    if sentences:
        return " ".join(sentences)
    channels = sum(len(signals.columns) for signals in view.run.signals(source.accepted[0].index).values())
    return f"It declares no objective: what it measured is the signals of {counted(channels, 'channel')}, shown below."


def checks(source: ReportSource) -> list[Check]:
    """Return what decides whether the run can be believed, in the order of the sections."""
    if not source.run.outcomes:
        return []
    found = [*_noise(source), *_steadiness(source), *_rest(source), *_sampling(source), *_losses(source)]
    return [check for check in found if not (source.imported and check.verdict == "open")]


def _noise(source: ReportSource) -> list[Check]:
    name = source.view.objective
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
    item = next((item for item in source.drift if item.objective == source.view.objective), source.drift[0])
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


def _check(check: Check) -> Html:
    topic = _TOPICS.get(check.anchor, check.anchor)
    label = element("b", f"{_MARKS[check.verdict]} {topic}", class_=check.verdict)
    return element("li", label, check.text, " ", element("a", "more", href=f"#{check.anchor}"))


def _best(source: ReportSource, best: Best) -> Html:
    value, interval = interval_words(best.value, best.ci95, best.unit)
    confirming = counted(best.trials, "confirming trial")
    below: Content = f"95 % interval {interval}, from {confirming} that took no part in the choice"
    if not interval:
        below = f"no interval: {confirming}"
    if not source.finished:
        below = f"{below}; provisional, the confirmation was not completed"
    return element(
        "div",
        element("div", element("span", f"honest best, {spaced(best.objective_name)}"), element("b", value),
                element("span", below)),
        element("div", element("span", "luckiest single trial"), element("b", quantity_text(best.luckiest, best.unit)),
                element("span", "not what to expect"), class_="lucky"),
        element("div", f"at {named_condition(best.parameters, source.experiment.units)}", class_="at"),
        class_="best",
    )  # fmt: skip


def _range(source: ReportSource, objective: str) -> str:
    points = source.view.points(objective)
    if not points:
        return ""
    unit, name = source.view.unit_of(objective), spaced(objective)
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


def _fitted(source: ReportSource) -> Html | None:
    if not stored_fits(source.folder):
        return None
    return paragraph(
        "A model was fitted to it: ", element("a", "parameters with their intervals", href="#fits"), "."
    )


def _unfinished(source: ReportSource) -> Html | None:
    if source.finished or source.folder is None:
        return None
    last = next(
        (
            event
            for event in reversed(source.run.events)
            if event["event"] in ("interrupted", "failed", "limit-reached")
        ),
        None,
    )
    why = ""
    if last is not None and last["event"] == "limit-reached":
        why = f" It stopped as asked, after {last.get('limit')} new trials."
    elif last is not None:
        why = f" It last ended with: {last.get('reason', last['event'])}."
    return paragraph(
        f"This run is not finished: what follows is the state after {counted(len(source.run.outcomes), 'trial')}.{why} "
        "If it is not running now, to go on: ",
        element("code", resume_line(source.folder)),
        class_="stop",
    )
