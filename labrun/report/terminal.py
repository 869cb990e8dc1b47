"""Runs, recordings, fits, plans and remarks in a terminal."""

import math
import re
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console, OverflowMethod
from rich.table import Table
from rich.text import Text

from labrun.devices import Remark
from labrun.estimate import rounded
from labrun.experiment import Key, varying
from labrun.report.conditions import ConditionResult, standard_error
from labrun.report.data import Point
from labrun.report.findings import Findings, StoredFit
from labrun.report.statistics import Drift, Repeatability, repeatability_columns, standard_deviations
from labrun.report.text import (
    bytes_text,
    condition_text,
    decimal_text,
    decimals_for,
    duration_text,
    interval_text,
    label,
    quantity_text,
    share_text,
    short_time_text,
    value_text,
    with_unit,
)
from labrun.report.timing import LEAST_JITTER_S, clock_text, loop_words
from labrun.runner import JointPeak, Plan, percent
from labrun.search import Best, combined_text, unsettled_text

_MOST_REASONS = 6
_LINK = re.compile(r"\[(.*?)\]\(#[^)]*\)")
_STATUSES = ("done", "rejected", "failed")


def print_findings(findings: Findings, console: Console | None = None) -> None:
    """Print the results of a run or the contents of a recording."""
    console = console or Console(highlight=False)
    if findings.channels:
        _print_recording(findings.to_json(), console)
    else:
        _print_run(findings, console)


def _print_run(findings: Findings, console: Console) -> None:
    """Print what the run was, its best, and what speaks for and against trusting it."""
    run = findings.run
    console.print(Text(findings.experiment.title, style="bold"))
    state = "finished" if findings.finished else f"not finished; labrun resume {run.path}"
    dry = "dry run, " if findings.dry_run else "emulated, " if findings.emulated else ""
    lasted = duration_text(findings.bench_time_s)
    how = "simulated" if findings.simulated_only else f"{dry}{lasted} of bench time"
    console.print(Text(f"{run.name}, {findings.experiment.kind}, {how}, {state}"))
    for fault in run.faults:
        console.print(Text(f"damaged: {fault}", style="yellow"))
    if findings.best is not None and findings.finished:
        console.print(_best(findings.best))
    for line in [] if findings.result is None else (*findings.result.search_lines(), *findings.result.more):
        console.print(Text(line))
    print_conditions(findings, console)
    _print_trials(findings, console)
    if not findings.simulated_only:
        _print_trust(findings, console)
    for fit in findings.fits:
        print_fit(fit, console)
    console.print(Text(f"run     {run.path}"), soft_wrap=True)
    if findings.figure is not None:
        console.print(Text(f"figure  {findings.figure}"), soft_wrap=True)


def _print_trials(findings: Findings, console: Console) -> None:
    table = _table("trials", "role", *_STATUSES)
    for role, counts in findings.trials.items():
        table.add_row(role, *(str(counts.get(status, 0)) for status in _STATUSES))
    console.print(table)
    spoiled = [f"{count} x {reason}" for reason, count in list(findings.reasons.items())[:_MOST_REASONS]]
    for text in (*spoiled, *_shortened(findings.damage), *_shortened(findings.remarks)):
        console.print(Text(f"  {text}", style="yellow"))


def _print_trust(findings: Findings, console: Console) -> None:
    """Print what speaks for and against trusting the run."""
    if findings.repeatability:
        console.print(_repeatability(findings.repeatability))
    if findings.drift:
        console.print(_drift(findings.drift))
    if findings.settling is not None:
        settling = findings.settling
        reasons = ", ".join(f"{count} {reason}" for reason, count in settling.reasons.items())
        median, longest = short_time_text(settling.median_s), short_time_text(settling.longest_s)
        console.print(Text(f"settling: {reasons}; median {median}, longest {longest}"))
    if findings.unsettled:
        warning = unsettled_text(findings.unsettled, len(findings.accepted))
        console.print(Text(f"warning: {warning}", style="bold yellow"))
    if findings.streams:
        console.print(_streams(findings))
    if findings.loop is not None:
        style = "yellow" if findings.loop.missed else ""
        console.print(Text(f"loop: {loop_words(findings.loop)}", style=style))


def _shortened(texts: Sequence[str]) -> list[str]:
    """Return the first of these, and how many more there are."""
    more = len(texts) - _MOST_REASONS
    return [*texts[:_MOST_REASONS], *([f"and {more} more; --json has all"] if more > 0 else [])]


def _print_recording(recording: Mapping[str, Any], console: Console) -> None:
    """Print what a recording holds, as `Findings.to_json` tells: its channels, and its trials by condition."""
    console.print(Text(f"Recording {recording['experiment']}", style="bold"))
    console.print(
        Text(f"{recording['trials']} trials, {short_time_text(recording['duration_s'])} of samples")
    )
    for fault in recording["faults"]:
        console.print(Text(f"damaged: {fault}", style="yellow"))
    source = recording["source"]
    if source:
        parts = [f"{key} {value}" for key, value in source.items() if key != "kind"]
        console.print(Text(f"source: {', '.join([source.get('kind', ''), *parts])}"))
    channels = _table("channels", "channel", "kind", "unit", "rate")
    for channel in recording["channels"]:
        channels.add_row(channel["name"], channel["kind"], channel["unit"], f"{channel['rate_hz']:.4g} Hz")
    console.print(channels)
    if all("means" in condition for condition in recording["conditions"]):
        console.print(_table_of_numbers(recording))
    else:
        console.print(_trials_by_condition(recording))
    paths = {"run": recording["run"], "imported from": recording["imported_from"]}
    if recording["run"] == recording["imported_from"]:
        paths = {"recording": recording["run"]}
    for name, path in paths.items():
        console.print(Text(f"{name:<13} {path}"), soft_wrap=True)


def _table_of_numbers(recording: Mapping[str, Any]) -> Table:
    """Return a recording without a course in time as the table that it is."""
    columns = [with_unit(channel["name"], channel["unit"]) for channel in recording["channels"]]
    table = _table("means by condition", "condition", "trials", *columns)
    for condition in recording["conditions"]:
        numbers = [f"{condition['means'][channel['name']]:.4g}" for channel in recording["channels"]]
        table.add_row(
            condition_text(condition["condition"]) or "(none given)", str(condition["trials"]), *numbers
        )
    return table


def _trials_by_condition(recording: Mapping[str, Any]) -> Table:
    table = _table("trials by condition", "condition", "trials", "done", "duration")
    for condition in recording["conditions"]:
        shortest, longest = f"{condition['shortest_s']:.4g}", f"{condition['longest_s']:.4g}"
        lasted = f"{longest} s" if shortest == longest else f"{shortest} to {longest} s"
        name = condition_text(condition["condition"]) or "(none given)"
        table.add_row(name, str(condition["trials"]), str(condition["done"]), lasted)
    return table


def _best(best: Best) -> Text:
    return Text.assemble(
        ("best ", "bold"),
        f"{best.objective_name} = ",
        (interval_text(best.value, best.ci95, best.unit), "bold green"),
        f", {best.combined}" if best.combined else "",
        f" (95 % interval, {best.trials} confirming trials)\n",
        f"  at {condition_text(best.parameters)}\n",
        *(f"  {note}\n" for note in best.range_ends),
        (f"  luckiest single trial {quantity_text(best.luckiest, best.unit)}", "dim"),
    )


def print_fit(fit: StoredFit, console: Console) -> None:
    """Print a fit's estimates and what it says of itself."""
    if fit.fault:
        console.print(Text(f"fit {fit.path.name} cannot be read: {fit.fault}", style="yellow"))
        return
    table = _table(f"fit: {fit.title}", "parameter", "value, 95 % interval", "unit")
    for name, estimate in fit.estimates.items():
        value, low, high = rounded(estimate)
        table.add_row(name, f"{value} [{low}, {high}]", estimate.unit)
    console.print(table)
    for sentence in fit.sentences("findings"):
        console.print(Text(f"- {sentence}"))
    for sentence in fit.sentences("warnings"):
        console.print(Text(f"! {sentence}", style="yellow"))


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number == 0 else "right")
    return table


def _repeatability(repeatabilities: Sequence[Repeatability]) -> Table:
    table = _table("repeatability", "objective", *repeatability_columns(repeatabilities), "freedom")
    for repeatability in repeatabilities:
        sds = standard_deviations(repeatability, repeatabilities)
        cells = ["" if sd is None else quantity_text(sd, repeatability.unit) for sd in sds]
        table.add_row(repeatability.objective, *cells, str(repeatability.degrees_of_freedom))
    return table


def _drift(drifts: Sequence[Drift]) -> Table:
    table = _table(
        "drift, by reference trials", "objective", "per hour of bench time, 95 % interval", "trials", ""
    )
    for drift in drifts:
        slope = interval_text(drift.slope_per_h, drift.ci95, f"{drift.unit}/h")
        verdict = Text("drifts", style="yellow") if drift.visible else Text("none visible")
        table.add_row(drift.objective, slope, str(drift.trials), verdict)
    return table


def _streams(findings: Findings) -> Table:
    title = f"streams, from {len(findings.streams_looked_at)} trials"
    # The clocks of simulated devices are made up: how far they are from the run's says nothing of a bench.
    clock = () if findings.dry_run else ("offset", "drift")
    columns = ("device", "rate, nominal (Hz)", "jitter", *clock, "samples", "lost", "saturated")
    table = _table(title, *columns)
    table.collapse_padding = True  # with short words, all of it fits a terminal of 80 columns
    for stream in findings.streams:
        style = "yellow" if stream.lost or stream.saturated else ""
        table.add_row(
            stream.device,
            f"{stream.actual_hz:.4g}, {stream.nominal_hz:.4g}",
            f"{1000 * stream.jitter_s:.2g} ms" if stream.jitter_s > LEAST_JITTER_S else "0 ms",
            *(() if findings.dry_run else clock_text(stream)),
            str(stream.samples),
            f"{stream.lost} ({share_text(stream.lost_share)})",
            str(stream.saturated),
            style=style,
        )
    return table


_ALL_SHOWN = 12
_BEST_SHOWN = 10
_UNBOUNDED = 10_000


def print_conditions(findings: Findings, console: Console) -> None:
    """Print what every condition gave: all of a few, or the most promising of many."""
    if not findings.objective_units or not findings.conditions:
        return
    shown = _shown(findings)
    table = _condition_table(findings, shown, " ")
    unbounded = console.options.update(max_width=_UNBOUNDED)
    if console.measure(table, options=unbounded).maximum > console.width:
        table = _condition_table(findings, shown, "\n")  # units below the names, so that no number is broken
        table.collapse_padding = True
        if console.measure(table, options=unbounded).maximum > console.width:
            table = _condition_table(findings, shown, "\n", means_only=True)
            table.collapse_padding = True
    console.print(table)
    if len(shown) < len(findings.conditions):
        text = f"... of {len(findings.conditions)} conditions"
        if findings.experiment.goal is not None:
            text += "; all accepted trials: what leads is on average too good"
        console.print(Text(text))


def _condition_table(
    findings: Findings, shown: Sequence[ConditionResult], before_unit: str, *, means_only: bool = False
) -> Table:
    """Return the table; with `means_only` as narrow as it gets: no intervals, and names on several lines."""
    names = varying(result.condition for result in findings.conditions)
    headed = (
        f"conditions, by {findings.experiment.goal[0]}"
        if findings.experiment.goal is not None
        else "conditions"
    )
    over = combined_text(findings.experiment)
    headed += f", {over}" if over else ""
    title = f"{headed}: means{' (a wider terminal shows intervals)' if means_only else ' ± half their 95 % intervals'}"
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in names:
        words = any(isinstance(result.condition.get(name), str) for result in shown)
        heading = label(name, findings.experiment.units).replace(" (", f"{before_unit}(")
        table.add_column(heading, justify="left" if words else "right")
    table.add_column("n", justify="right")
    decimals: dict[str, int | None] = {}
    for name, unit in findings.objective_units.items():
        heading = with_unit(name.replace("_", "_\n") if means_only else name, unit)
        overflow: OverflowMethod = "fold" if means_only else "ellipsis"
        table.add_column(heading.replace(" (", f"{before_unit}("), justify="right", overflow=overflow)
        points = [result.points[name] for result in shown if name in result.points]
        decimals[name] = decimals_for(standard_error(point) for point in points)
        if means_only:
            largest = max((abs(point.mean) for point in points), default=0.0)
            decimals[name] = min(max(0, 2 - math.floor(math.log10(largest))), 4) if largest > 0 else 0
    together = decimals_for(
        standard_error(result.combined) for result in shown if result.combined is not None
    )
    if over:
        table.add_column(
            f"{findings.experiment.combine} over\n{', '.join(findings.experiment.over)}", justify="right"
        )
    marked = any(result.best for result in shown)
    if marked:
        table.add_column("")
    for result in shown:
        cells = [value_text(result.condition[name]) if name in result.condition else "" for name in names]
        cells.append(str(result.accepted))
        cells += [_mean(result, name, decimals[name], alone=means_only) for name in findings.objective_units]
        if over:
            cells.append(
                "" if result.combined is None else _of_point(result.combined, together, alone=means_only)
            )
        if marked:
            cells.append("best" if result.best else "")
        table.add_row(*cells, style="green" if result.best else "")
    return table


def _shown(findings: Findings) -> list[ConditionResult]:
    if len(findings.conditions) <= _ALL_SHOWN:
        return list(findings.conditions)
    shown = list(findings.conditions[: _BEST_SHOWN if findings.experiment.goal is not None else _ALL_SHOWN])
    winner = next((result for result in findings.conditions if result.best), None)
    if winner is not None and winner not in shown:
        shown[-1] = winner
    return shown


def _mean(result: ConditionResult, objective: str, decimals: int | None, *, alone: bool = False) -> str:
    point = result.points.get(objective)
    return "" if point is None else _of_point(point, decimals, alone=alone)


def _of_point(point: Point, decimals: int | None, *, alone: bool) -> str:
    if point.at_least:
        return f"> {decimal_text(point.mean, decimals)}"
    if alone:
        return f"{round(point.mean, decimals or 0) + 0.0:.{decimals or 0}f}"
    mean, interval = decimal_text(point.mean, decimals), point.ci95
    return mean if interval is None else f"{mean} ± {decimal_text(interval[1] - point.mean, decimals)}"


_NO_LIMIT = "no limit set"
_NAMED = 6
"""Of the constraints and limits that exclude part of a search space, so many are named."""


def plan_text(plan: Plan, results: Path) -> str:
    """Return a plan as text: trials, time, disk, and the demand on every joint with its limits.

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
        *_what_is_measured(plan),
        f"trials      {_between(str(plan.trials), str(plan.trials_at_most))}",
    ]
    if plan.time_at_most_s > 0.0:  # a design has no bench
        lines += [
            f"time        {_between(duration_text(plan.time_s), duration_text(plan.time_at_most_s))} on the bench, "
            f"{_settling(plan)}",
            f"disk        {bytes_text(plan.disk_bytes)} of {bytes_text(free)} free, "
            f"{bytes_text(plan.disk_kept_bytes)} once it is packed",
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
        return f"counting {plan.settle_s:g} s of settling before each trial"
    return (
        f"counting {plan.settle_s:g} s of settling before each trial (the least that evidence takes) to "
        f"{plan.settle_at_most_s:g} s (its timeout)"
    )


def _between(least: str, most: str) -> str:
    return least if least == most else f"{least} to {most}"


def _joint(peak: JointPeak) -> str:
    low, high = (angle + 0.0 for angle in peak.angle_deg)  # 0 for -0
    angle = f"{low:.4g} deg" if low == high else f"{low:.4g} to {high:.4g} deg"
    limit = peak.angle_limit_deg
    angle += f" ({_NO_LIMIT})" if limit is None else f" (limit {limit[0]:g} to {limit[1]:g})"
    speed = f"at most {peak.speed_deg_s:.4g} deg/s"
    name = peak.joint if peak.joint == peak.device else f"{peak.joint} of {peak.device}"
    if not peak.speed_deg_s:
        return f"{name}: {angle}, not driven from there"
    speed_limit = peak.speed_limit_deg_s
    speed += f" ({_NO_LIMIT})" if speed_limit is None else f" (limit {speed_limit:g})"
    return f"{name}: {angle}, {speed}"


_INDENT = " " * 9


def remark_text(remark: Remark, width: int | None = None) -> str:
    """Return a remark and its advice.

    Parameters
    ----------
    width
        Of a line; the terminal's if None.
    """
    columns = shutil.get_terminal_size((120, 24)).columns if width is None else width
    lines = [_wrapped(f"{remark.verdict:<8} {remark.subject}: {remark.message}", columns, _INDENT)]
    if remark.advice:
        lines.append(_wrapped(f"{_INDENT}-> {remark.advice}", columns, f"{_INDENT}   "))
    return "\n".join(lines)


def _wrapped(text: str, columns: int, indent: str) -> str:
    # what is to be typed or looked up stays whole: paths and commands have no blanks to break at
    return textwrap.fill(
        text, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def keys_text(keys: Sequence[Key]) -> str:
    """Return keys of an experiment file, a paragraph each: place, what it takes, default and unit, then its meaning."""
    columns = shutil.get_terminal_size((120, 24)).columns
    lines = []
    for key in keys:
        default = "" if not key.default else key.default if " " in key.default else f"default {key.default}"
        facts = [key.takes, default, f"in {key.unit}" if key.unit else ""]
        lines.append(_wrapped(f"{key.path}: {', '.join(fact for fact in facts if fact)}", columns, "    "))
        if key.meaning:
            lines.append(_wrapped(f"    {_LINK.sub(lambda link: link[1], key.meaning)}", columns, "    "))
    return "\n".join(lines).replace("`", "")
