"""The page of a run: the context of its template."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from labrun.estimate import Estimate, rounded
from labrun.experiment import condition_text
from labrun.report.conditions import conditions_context
from labrun.report.figures import run_figure
from labrun.report.figures.trust import MOST_PANELS, draw_drift, draw_repeatability, draw_settling
from labrun.report.findings import Findings, StoredFit, as_list, as_table, is_number
from labrun.report.page import PageFigure, PageTable, drawn, render
from labrun.report.statistics import repeatability_columns, standard_deviations
from labrun.report.text import (
    counted,
    duration_text,
    interval_words,
    named_condition,
    quantity_text,
    scatter_text,
    share_text,
    short_time_text,
    spaced,
    with_unit,
)
from labrun.report.timing import LEAST_JITTER_S, STEPS, clock_text, command_health, loop_words
from labrun.report.verdict import (
    checks,
    drift_sentence,
    what_came_out,
    what_it_resolves,
    what_was_run,
    why_it_went_on,
    why_unfinished,
)
from labrun.search import apart_text, resume_line
from labrun.signals import Signals
from labrun.store import TrialOutcome

_SHOWN_ELSEWHERE = frozenset(
    {
        "parameters", "rmse", "figure", "warnings", "model", "method", "source", "fixed", "findings", "tables",
        "by_trial",
    }
)  # fmt: skip
_DEEPEST = 2
_MOST_ITEMS = 8
_TRIALS_SHOWN = 200
_UNFOLDED = 12
_INCIDENTS = ("interrupted", "failed", "stopped", "damaged", "resumed", "limit-reached")
_STEP_WORDS = {
    "move": "moving to the start",
    "settle": "settling",
    "tare": "taring",
    "record": "recording",
    "safe pose": "moving to the safe pose",
    "store": "storing",
}
_TOLD_APART = frozenset(
    {"experiment_text", "versions", "machine", "git", "devices", "command", "dry_run", "emulated", "seed"}
)
_LINKS = {"result": "figure", "rejected": "rejected trials"}


def report_page(findings: Findings) -> str:
    """Return the page of a run; the same run gives the same text, byte for byte."""
    return render("run.html.j2", run_context(findings))


def run_context(findings: Findings) -> dict[str, Any]:
    """Return the context of the template ``run.html.j2``; empty sections are None."""
    run = findings.run
    sections = {
        "design": _design(findings),
        "result": _figure(findings),
        "search": _search(findings),
        "conditions": conditions_context(findings) if findings.accepted else None,
        **dict.fromkeys(_OF_A_BENCH),
        **({} if findings.simulated_only else {name: tell(findings) for name, tell in _OF_A_BENCH.items()}),
        "rejected": _rejected(findings),
        "fits": [fit_context(fit) for fit in findings.fits] or None,
        "gap": findings.diagnosis,
        "provenance": {
            "origin": PageTable(("", ""), _origin(run.provenance), words=(0, 1)),
            "resolved": run.experiment_toml,
            "written": run.provenance.get("experiment_text"),
        },
    }
    return {
        "title": f"{findings.experiment.title} ({run.identifier})",
        "findings": findings,
        "folder": run.path if findings.folder is None else findings.folder,
        "links": [
            (name, _LINKS.get(name, name)) for name, section in sections.items() if section is not None
        ],
        "to_go_on": None if findings.finished or findings.folder is None else resume_line(findings.folder),
        "why_unfinished": why_unfinished(findings),
        "what_was_run": what_was_run(findings),
        "best": _best(findings),
        "what_came_out": "" if findings.best is not None else what_came_out(findings),
        "checks": checks(findings),
        **sections,
    }


def _figure(findings: Findings) -> PageFigure | None:
    alt = f"Result of {findings.experiment.title}: the numbers it shows stand in the tables below"
    return drawn(lambda: run_figure(findings, findings.generations), "result", alt)


def _best(findings: Findings) -> Mapping[str, str] | None:
    best = findings.best
    if best is None:
        return None
    value, interval = interval_words(best.value, best.ci95, best.unit)
    confirming = counted(best.trials, "confirming trial")
    below = f"95 % interval {interval}, from {confirming} that took no part in the choice"
    if not interval:
        below = f"no interval: {confirming}"
    if not findings.finished:
        below += "; provisional, the confirmation was not completed"
    return {
        "name": spaced(best.objective_name),
        "value": value,
        "below": below,
        "luckiest": quantity_text(best.luckiest, best.unit),
        "at": named_condition(best.parameters, findings.experiment.units),
        "range_ends": "; ".join(best.range_ends),
    }


def _design(findings: Findings) -> Mapping[str, Any] | None:
    """Return the active constraints and the drawing of a finished design; None for other runs."""
    result = findings.result
    if result is None or not findings.simulated_only or not result.more:
        return None
    rows = [line.split(maxsplit=1) for line in result.more]
    alt = f"Drawing to scale: {findings.experiment.title}"
    return {
        "told": PageTable(("", ""), rows, words=(0, 1), marked=_places(rows, "active")),
        "drawing": None
        if findings.drawing is None
        else PageFigure.of_png(findings.drawing.read_bytes(), alt),
    }


def _places(rows: Sequence[Sequence[str]], word: str) -> list[int]:
    return [index for index, row in enumerate(rows) if row[0] == word]


def _search(findings: Findings) -> Mapping[str, Any] | None:
    """How each search ended, and the winners of several side by side; None for a run that did not search."""
    result = findings.result
    if result is None or not result.verdicts:
        return None
    levels = [verdict.level or {} for verdict in result.verdicts]
    ended = [
        f"{condition_text(level)}: {verdict.text}" if level else verdict.text
        for level, verdict in zip(levels, result.verdicts, strict=True)
    ]
    if len(result.winners) < 2:  # the one there is stands at the head of the page
        return {"ended": ended, "winners": None, "apart": ""}
    names = list(dict.fromkeys(name for level in levels for name in level))
    rows = []
    for best in result.winners:
        value, interval = interval_words(best.value, best.ci95, best.unit)
        level = [str(best.parameters[name]) for name in names]
        rows.append([*level, value, interval or "none", str(best.trials)])
    columns = [*names, spaced(result.winners[0].objective_name), "95 % interval", "confirming trials"]
    table = PageTable(columns, rows, words=tuple(range(len(names))), marked=(0,))
    return {"ended": ended, "winners": table, "apart": apart_text(result.winners, levels)}


# How far the run can be believed


def _repeatability(findings: Findings) -> Mapping[str, Any] | None:
    spreads = findings.repeatability
    if not spreads:
        return {"table": None} if findings.experiment.objectives and findings.accepted else None
    main = next((item for item in spreads if item.objective == findings.objective), spreads[0])
    rows = [
        [
            spaced(item.objective),
            *("" if sd is None else scatter_text(sd, item.unit) for sd in standard_deviations(item, spreads)),
            str(item.degrees_of_freedom),
        ]
        for item in spreads
    ]
    alt = f"Standard deviation of repeated trials against the mean of {main.objective}, one dot a condition"
    return {
        "told": what_it_resolves(findings, main),
        "figure": drawn(lambda: draw_repeatability(findings, main), "repeatability", alt),
        "table": PageTable(("objective", *repeatability_columns(spreads), "degrees of freedom"), rows),
    }


def _drift(findings: Findings) -> Mapping[str, Any] | None:
    if not findings.experiment.objectives or not findings.run.outcomes:
        return None
    if not findings.drift:
        references = sum(outcome.role == "reference" for outcome in findings.run.outcomes)
        there = f"There {'is' if references == 1 else 'are'} {counted(references, 'reference trial')}"
        return {"too_few": there}
    shown = ", ".join(item.objective for item in findings.drift[:MOST_PANELS])
    alt = f"Reference trials over bench time with the line through them, for {shown}"
    return {
        "too_few": "",
        "told": [drift_sentence(findings, item) for item in findings.drift],
        "figure": drawn(lambda: draw_drift(findings, findings.drift), "drift", alt),
    }


def _settling(findings: Findings) -> Mapping[str, Any] | None:
    settling = findings.settling
    if settling is None:
        return None
    watched = {outcome.settle.channel for outcome in findings.run.outcomes if outcome.settle is not None}
    alt = "Distribution of settle times by reason, and settle times in the order of the trials"
    return {
        "told": f"{why_it_went_on(settling)} Half of the waits took {settling.median_s:.3g} s or less, the longest "
        f"{short_time_text(settling.longest_s)}.",
        "watched": ", ".join(sorted(channel for channel in watched if channel)),
        "figure": drawn(lambda: draw_settling(findings.run.outcomes), "settling", alt),
    }


# Time


def _timing(findings: Findings) -> Mapping[str, Any] | None:
    if not findings.run.outcomes:
        return None
    looked, of = len(findings.streams_looked_at), len(findings.run.outcomes)
    return {
        "bench": _bench(findings),
        "loop": None if findings.loop is None else (loop_words(findings.loop), bool(findings.loop.missed)),
        "commands": _commands(findings),
        "streams": _streams(findings),
        "channels": _channels(findings),
        "looked_at": f"{counted(looked, 'trial')} "
        + (f"(all {looked})" if looked == of else f"({looked} of {of}, evenly over the run)"),
    }


def _bench(findings: Findings) -> Mapping[str, Any] | None:
    spent = findings.bench_time
    if spent is None:
        return None
    longest = max(STEPS, key=spent.of)
    return {
        "total": duration_text(spent.total_s),
        "each": short_time_text(spent.total_s / len(findings.run.outcomes)),
        "longest": _STEP_WORDS[longest],
        "longest_share": share_text(spent.of(longest), spent.total_s),
        "rows": [
            {
                "step": _STEP_WORDS[step],
                "share": spent.of(step) / spent.total_s,
                "total": duration_text(spent.of(step)),
                "median": f"{spent.median_s(step):.{2 if spent.median_s(step) < 10 else 3}g} s",
            }
            for step in STEPS
            if step in spent.steps
        ],
    }


def _commands(findings: Findings) -> PageTable | None:
    """Return how evenly set-points went out; None where no device tells."""
    rows = [
        [
            device,
            f"{item.rate_hz:.4g}",
            str(item.sent),
            f"{item.missed} ({share_text(item.missed, item.sent + item.missed)})" if item.missed else "0",
            *(f"{1e3 * late_s:.2g}" for late_s in (item.late_median_s, item.late_p99_s, item.late_worst_s)),
        ]
        for device, item in command_health(findings.run.events).items()
    ]
    columns = ("device", "rate (Hz)", "sent", "skipped", "late, median (ms)", "99 % (ms)", "worst (ms)")
    return PageTable(columns, rows) if rows else None


def _channels(findings: Findings) -> PageTable | None:
    """Return what each device measured, by the first trial; None where nothing streamed."""
    if not findings.streams:
        return None
    first = findings.run.signals(findings.run.outcomes[0].index)
    rows = [
        [item.device, _listed_channels(first[item.device])]
        for item in findings.streams
        if item.device in first
    ]
    return PageTable(("device", "channels"), rows, words=(0, 1))


def _streams(findings: Findings) -> PageTable | None:
    if not findings.streams:
        return None
    rows = [
        [
            item.device,
            f"{item.nominal_hz:.4g}",
            f"{item.actual_hz:.4g}",
            f"{1000 * item.jitter_s:.2g}" if item.jitter_s > LEAST_JITTER_S else "0",
            *(() if findings.dry_run else clock_text(item)),
            str(item.samples),
            f"{item.lost} ({share_text(item.lost, item.samples + item.lost)})" if item.lost else "0",
            str(item.saturated),
        ]
        for item in findings.streams
    ]
    # The clocks of simulated devices are made up: how far they are from the run's says nothing of a bench.
    clock = () if findings.dry_run else ("clock offset", "drift")
    columns = (
        "device", "nominal (Hz)", "actual (Hz)", "jitter, sd (ms)", *clock, "samples", "lost", "saturated",
    )  # fmt: skip
    marked = [index for index, item in enumerate(findings.streams) if item.saturated]
    return PageTable(columns, rows, marked=marked)


def _listed_channels(signals: Signals) -> str:
    return ", ".join(with_unit(name, unit) for name, unit in zip(signals.columns, signals.units, strict=True))


_OF_A_BENCH = {"repeatability": _repeatability, "drift": _drift, "settling": _settling, "timing": _timing}
"""Sections that say how far measurements can be believed."""


# Fits


def fit_context(fit: StoredFit) -> Mapping[str, Any]:
    """Return the context of a fit on a page."""
    numbers = fit.numbers
    if fit.fault:
        return {"fault": f"{fit.path.name} cannot be read ({fit.fault}): labrun fit writes it again."}
    fixed = as_table(numbers.get("fixed")).items()
    estimates = fit.estimates
    rows = [
        [spaced(str(name)), *_estimate(entry, estimates.get(str(name)))]
        for name, entry in numbers["parameters"].items()
    ]
    rows += [[spaced(str(name)), _short(value), "as given", ""] for name, value in fixed]
    rest = [
        [f"rms of measured - simulated, {spaced(str(name))}", _short(value)]
        for name, value in as_table(numbers.get("rmse")).items()
    ]
    for name, value in numbers.items():
        if name not in _SHOWN_ELSEWHERE:
            rest += _entries(spaced(str(name)), value, 1)
    alt = f"Measured and simulated signals of the fit of {fit.model}, and residuals"
    return {
        "fault": "",
        "title": fit.title,
        "warnings": fit.sentences("warnings"),
        "findings": fit.sentences("findings"),
        "parameters": PageTable(("parameter", "value", "95 % interval", "unit"), rows, words=(0, 3)),
        "tables": [table for entry in as_list(numbers.get("tables")) if (table := _fit_table(entry))],
        "rest": PageTable(("", ""), rest),
        "figure": None if fit.picture is None else PageFigure.of_png(fit.picture, alt),
    }


def _estimate(entry: Any, known: Estimate | None) -> tuple[str, str, str]:
    """Return value, interval and unit; `known` is None of an entry without a number and an interval."""
    if not isinstance(entry, Mapping):
        return _short(entry), "", ""
    if known is None:
        return _short(entry.get("value")), "not known", str(entry.get("unit", ""))
    middle, low, high = rounded(known)
    return middle, f"{low} to {high}", known.unit


def _fit_table(entry: Any) -> PageTable | None:
    """Return a table that a method has stored as it prints it; rows that are not whole are left out."""
    known = as_table(entry)
    header = tuple(str(value) for value in as_list(known.get("header")))
    rows = [[str(cell) for cell in row] for row in as_list(known.get("rows")) if isinstance(row, list)]
    whole = [row for row in rows if len(row) == len(header)]
    return PageTable(header, whole, caption=str(known.get("title", ""))) if header and whole else None


def _entries(name: str, value: Any, depth: int) -> list[list[str]]:
    """Return whatever else a method has written down, as rows of a table."""
    if isinstance(value, Mapping):
        if depth > _DEEPEST:
            return []
        parts = ((f"{name}, {spaced(str(key))}", item) for key, item in value.items())
        return [row for part, item in parts for row in _entries(part, item, depth + 1)]
    if isinstance(value, list):
        plain = len(value) <= _MOST_ITEMS and not any(isinstance(item, dict | list) for item in value)
        return [[name, ", ".join(_short(item) for item in value)]] if plain else []
    return [[name, _short(value)]]


def _short(value: Any) -> str:
    if is_number(value):
        return f"{value:.5g}"
    return "not known" if value is None else str(value)


# Trials that do not count


def _rejected(findings: Findings) -> Mapping[str, Any] | None:
    total = len(findings.run.outcomes)
    if not total:
        return None
    counts = Counter((outcome.status, _kind_of(outcome)) for outcome in findings.spoiled)
    reasons = [
        [status, reason, str(count), share_text(count, total)]
        for (status, reason), count in counts.most_common()
    ]
    trials = [
        [
            str(outcome.index),
            outcome.status,
            outcome.reason,
            named_condition(outcome.condition, findings.experiment.units),
            outcome.role,
            str(outcome.repeat + 1),
            str(outcome.attempt + 1),
        ]
        for outcome in findings.spoiled[:_TRIALS_SHOWN]
    ]
    columns = ("trial", "status", "reason", "condition", "role", "repeat", "attempt")
    incidents = [
        [str(event.get("time_utc", ""))[:19].replace("T", " "), event["event"], _told(event)]
        for event in findings.run.events
        if event["event"] in _INCIDENTS
    ]
    return {
        "total": total,
        "spoiled": len(findings.spoiled),
        "reasons": PageTable(("status", "reason", "trials", "share"), reasons, words=(0, 1)),
        "trials": PageTable(columns, trials, words=(1, 2, 3, 4)),
        "folded": len(findings.spoiled) > _UNFOLDED,
        "more": len(findings.spoiled) - len(trials),
        "incidents": PageTable(("UTC", "event", ""), incidents, words=(0, 1, 2)),
    }


def _kind_of(outcome: TrialOutcome) -> str:
    """Return the reason without the numbers of this one trial, so that like reasons count together."""
    head, colon, tail = (outcome.reason or "no reason given").partition(": ")
    return head if colon and any(character.isdigit() for character in tail) else head + colon + tail


def _told(event: Mapping[str, Any]) -> str:
    if event["event"] == "limit-reached":
        limit = event.get("limit")
        return "after one new trial, as asked" if limit == 1 else f"after {limit} new trials, as asked"
    if event["event"] == "resumed":
        changed = event.get("changed")
        return f"with a changed experiment file: {changed}" if changed else ""
    reason = str(event.get("reason") or event.get("cause") or "")
    failures = event.get("failures")
    return f"{reason}; did not stop: {failures}" if failures else reason


# Origin


def _origin(provenance: Mapping[str, Any]) -> list[list[str]]:
    rows = [["seed", str(provenance["seed"])]] if "seed" in provenance else []
    if "dry_run" in provenance:
        emulated = "emulated (real drivers)" if provenance.get("emulated") else "hardware"
        rows.append(["bench", "simulated (dry run)" if provenance["dry_run"] else emulated])
    rows += [
        [f"device {name}", _device(device)] for name, device in as_table(provenance.get("devices")).items()
    ]
    git = provenance.get("git")
    if git:
        changed = git.get("changed_files", 0)
        rows.append(
            ["git", f"{git.get('commit', '')}, {f'{changed} changed files' if changed else 'no changes'}"]
        )
    elif "git" in provenance:
        rows.append(["git", "the workspace was not under version control"])
    versions, machine = as_table(provenance.get("versions")), as_table(provenance.get("machine"))
    rows += [[f"{name} version", str(version)] for name, version in versions.items()]
    rows += [[str(name), str(value)] for name, value in machine.items()]
    command = provenance.get("command")
    if isinstance(command, list):
        rows.append(["command", " ".join(str(word) for word in command)])
    rest = {name: value for name, value in provenance.items() if name not in _TOLD_APART}
    return rows + [[spaced(str(name)), str(value)] for name, value in rest.items()]


def _device(device: Any) -> str:
    if not isinstance(device, Mapping):
        return str(device)
    known = [str(device.get("model", ""))]
    known += [f"{key} {device[key]}" for key in ("serial", "firmware") if device.get(key)]
    known += [f"{key} {value}" for key, value in as_table(device.get("details")).items()]
    return ", ".join(part for part in known if part)
