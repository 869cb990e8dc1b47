"""Findings as tables in a terminal."""

from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from labrun.fit.estimate import rounded
from labrun.report.condition_table import print_conditions
from labrun.report.loop_health import loop_words
from labrun.report.statistics import LEAST_JITTER_S, clock_text
from labrun.report.stored_fits import StoredFit
from labrun.report.text import condition_text, duration_text, interval_text, quantity_text
from labrun.search.result import unsettled_text

if TYPE_CHECKING:
    from labrun.report.findings import Findings
    from labrun.report.recording_findings import RecordingFindings

_MOST_REASONS = 6
_STATUSES = ("done", "rejected", "failed")


def print_findings(found: "Findings", console: Console | None = None) -> None:
    """Print findings: what the run was, its best, and what speaks for and against trusting it."""
    console = console or Console()
    console.print(Text(found.title, style="bold"))
    state = "finished" if found.finished else f"not finished; labrun resume {found.run}"
    dry = "dry run, " if found.dry_run else "emulated, " if found.emulated else ""
    console.print(
        Text(
            f"{found.experiment}, {found.kind}, {dry}{duration_text(found.bench_time_s)} of bench time, {state}"
        ),
        highlight=False,
    )
    for fault in found.faults:
        console.print(Text(f"damaged: {fault}", style="yellow"))
    _print_best(found, console)
    print_conditions(found, console)
    console.print(_trials(found))
    for reason, count in list(found.spoiled.items())[:_MOST_REASONS]:
        console.print(Text(f"  {count} x {reason}", style="yellow"), highlight=False)
    if found.repeatability:
        console.print(_repeatability(found))
    if found.drift:
        console.print(_drift(found))
    if found.settling is not None:
        reasons = ", ".join(f"{count} {reason}" for reason, count in found.settling.reasons.items())
        median, longest = (_waited(one) for one in (found.settling.median_s, found.settling.longest_s))
        text = f"settling: {reasons}; median {median}, longest {longest}"
        console.print(Text(text), highlight=False)
    if found.unsettled:
        warning = unsettled_text(found.unsettled, sum(by.get("done", 0) for by in found.trials.values()))
        console.print(Text(f"warning: {warning}", style="bold yellow"), highlight=False)
    if found.streams:
        console.print(_streams(found))
    if found.loop is not None:
        style = "yellow" if found.loop.missed else ""
        console.print(Text(f"loop: {loop_words(found.loop)}", style=style), highlight=False)
    for fit in found.fits:
        print_fit(fit, console)
    for name, path in (("run", found.run), ("figure", found.figure)):
        if path is not None:
            console.print(Text(f"{name:<7} {path}"), highlight=False, soft_wrap=True)


def print_recording(found: "RecordingFindings", console: Console | None = None) -> None:
    """Print what a recording holds: its channels, and its trials by condition."""
    console = console or Console()
    console.print(Text(f"Recording {found.experiment}", style="bold"))
    lasting = f"{found.duration_s:.3g} s" if found.duration_s < 60 else duration_text(found.duration_s)
    console.print(Text(f"{found.trials} trials, {lasting} of samples"), highlight=False)
    for fault in found.faults:
        console.print(Text(f"damaged: {fault}", style="yellow"))
    channels = _table("channels", "channel", "kind", "unit", "rate")
    for channel in found.channels:
        channels.add_row(channel.name, channel.kind, channel.unit, f"{channel.rate_hz:.4g} Hz")
    console.print(channels)
    conditions = _table("trials by condition", "condition", "trials", "done", "duration")
    for item in found.conditions:
        shortest, longest = f"{item.shortest_s:.4g}", f"{item.longest_s:.4g}"
        lasted = f"{longest} s" if shortest == longest else f"{shortest} to {longest} s"
        name = condition_text(item.condition) or "(none given)"
        conditions.add_row(name, str(item.trials), str(item.done), lasted)
    console.print(conditions)
    paths = {"run": found.run, "imported from": found.imported_from}
    if found.run == found.imported_from:
        paths = {"recording": found.run}
    for name, path in paths.items():
        console.print(Text(f"{name:<13} {path}"), highlight=False, soft_wrap=True)


def _print_best(found: "Findings", console: Console) -> None:
    best = found.best
    if best is None:
        return
    value = interval_text(best.value, best.ci95, best.unit)
    console.print(
        Text.assemble(
            ("best ", "bold"),
            f"{best.objective_name} = ",
            (value, "bold green"),
            f" (95 % interval, {best.trials} confirming trials)\n",
            f"  at {condition_text(best.parameters)}\n",
            (f"  luckiest single trial {quantity_text(best.luckiest, best.unit)}", "dim"),
        ),
        highlight=False,
    )


def print_fit(fit: StoredFit, console: Console) -> None:
    """Print a fit's estimates and what it says of itself."""
    if fit.fault:
        console.print(
            Text(f"fit {fit.path.name} cannot be read: {fit.fault}", style="yellow"), highlight=False
        )
        return
    table = _table(f"fit: {fit.title}", "parameter", "value, 95 % interval", "unit")
    for name, estimate in fit.estimates.items():
        value, low, high = rounded(estimate)
        table.add_row(name, f"{value} [{low}, {high}]", estimate.unit)
    console.print(table)
    for sentence in fit.sentences("findings"):
        console.print(Text(f"- {sentence}"), highlight=False)
    for sentence in fit.sentences("warnings"):
        console.print(Text(f"! {sentence}", style="yellow"), highlight=False)


def _waited(time_s: float) -> str:
    return f"{time_s:.1f} s" if time_s < 60 else duration_text(time_s)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number == 0 else "right")
    return table


def _trials(found: "Findings") -> Table:
    table = _table("trials", "role", *_STATUSES)
    for role, counts in found.trials.items():
        table.add_row(role, *(str(counts.get(status, 0)) for status in _STATUSES))
    return table


def _repeatability(found: "Findings") -> Table:
    table = _table("repeatability", "objective", "sd within a condition", "sd between conditions", "freedom")
    for item in found.repeatability:
        between = "" if item.between_sd is None else quantity_text(item.between_sd, item.unit)
        table.add_row(
            item.objective, quantity_text(item.sd, item.unit), between, str(item.degrees_of_freedom)
        )
    return table


def _drift(found: "Findings") -> Table:
    table = _table(
        "drift, by reference trials", "objective", "per hour of bench time, 95 % interval", "trials", ""
    )
    for item in found.drift:
        slope = interval_text(item.slope_per_h, item.ci95, f"{item.unit}/h")
        verdict = Text("drifts", style="yellow") if item.visible else Text("none visible")
        table.add_row(item.objective, slope, str(item.trials), verdict)
    return table


def _streams(found: "Findings") -> Table:
    title = f"streams, from {found.streams_of} trials"
    columns = ("device", "rate, nominal (Hz)", "jitter", "offset", "drift", "samples", "lost", "saturated")
    table = _table(title, *columns)
    table.collapse_padding = True  # with short words, all of it fits a terminal of 80 columns
    for item in found.streams:
        style = "yellow" if item.lost or item.saturated else ""
        table.add_row(
            item.device,
            f"{item.actual_hz:.4g}, {item.nominal_hz:.4g}",
            f"{1000 * item.jitter_s:.2g} ms" if item.jitter_s > LEAST_JITTER_S else "0 ms",
            *clock_text(item),
            str(item.samples),
            f"{item.lost} ({100 * item.lost_share:.2g} %)",
            str(item.saturated),
            style=style,
        )
    return table
