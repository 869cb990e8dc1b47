"""Rejected and failed trials with their reasons, and what interrupted the run."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from labrun.report.html_elements import Content, Html, element, folded, joined, paragraph, section, table
from labrun.report.report_source import ReportSource
from labrun.report.text import counted, named_condition, share_text
from labrun.store import TrialOutcome

_TRIALS_SHOWN = 200
_UNFOLDED = 12
_INCIDENTS = ("interrupted", "failed", "stopped", "damaged", "resumed", "limit-reached")


def rejected_section(source: ReportSource) -> Html | None:
    """Return which trials do not count and why; None before any trial."""
    if not source.run.outcomes:
        return None
    return section(
        "rejected", "Rejected and failed trials", _reasons(source), _trials(source), _incidents(source)
    )


def _reasons(source: ReportSource) -> Html:
    total = len(source.run.outcomes)
    if not source.spoiled:
        whole = "the one trial was accepted" if total == 1 else f"all {total} trials were accepted"
        return paragraph(f"None: {whole}.")
    counts = Counter((outcome.status, _kind_of(outcome)) for outcome in source.spoiled)
    rows: list[list[Content]] = [
        [status, reason, str(count), share_text(count, total)]
        for (status, reason), count in counts.most_common()
    ]
    text = (
        f"{counted(len(source.spoiled), 'trial')} of {total} do not count. They are kept with all their samples, and "
        "take no part in any number above."
    )
    return joined([paragraph(text), table(("status", "reason", "trials", "share"), rows, words=(0, 1))])


def _kind_of(outcome: TrialOutcome) -> str:
    """Return the reason without the numbers of this one trial, so that like reasons count together."""
    head, colon, tail = (outcome.reason or "no reason given").partition(": ")
    return head if colon and any(character.isdigit() for character in tail) else head + colon + tail


def _trials(source: ReportSource) -> Html | None:
    if not source.spoiled:
        return None
    units = source.experiment.units
    rows: list[list[Content]] = [
        [
            str(outcome.index),
            outcome.status,
            outcome.reason,
            named_condition(outcome.condition, units),
            outcome.role,
            str(outcome.repeat + 1),
            str(outcome.attempt + 1),
        ]
        for outcome in source.spoiled[:_TRIALS_SHOWN]
    ]
    columns = ("trial", "status", "reason", "condition", "role", "repeat", "attempt")
    listed = table(columns, rows, words=(1, 2, 3, 4))
    left = len(source.spoiled) - len(rows)
    more = paragraph(f"and {counted(left, 'more trial')}", class_="note") if left else None
    if len(source.spoiled) <= _UNFOLDED:
        return listed
    return folded(f"Each of the {len(source.spoiled)} trials", listed, more)


def _incidents(source: ReportSource) -> Html | None:
    events = [event for event in source.run.events if event["event"] in _INCIDENTS]
    if not events:
        return None
    rows: list[list[Content]] = [
        [str(event.get("time_utc", ""))[:19].replace("T", " "), event["event"], _told(event)]
        for event in events
    ]
    return joined(
        [element("h3", "What interrupted the run"), table(("UTC", "event", ""), rows, words=(0, 1, 2))]
    )


def _told(event: Mapping[str, Any]) -> str:
    if event["event"] == "limit-reached":
        limit = event.get("limit")
        return "after one new trial, as asked" if limit == 1 else f"after {limit} new trials, as asked"
    if event["event"] == "resumed":
        changed = event.get("changed")
        return f"with a changed experiment file: {changed}" if changed else ""
    text = str(event.get("reason") or event.get("cause") or "")
    failures = event.get("failures")
    return f"{text}; did not stop: {failures}" if failures else text
