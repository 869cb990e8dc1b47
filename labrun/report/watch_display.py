"""A run that is executed elsewhere, drawn in a terminal."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from labrun.devices import Clock
from labrun.report.braille import braille_curve
from labrun.report.snapshot import Snapshot, State
from labrun.report.text import condition_text, duration_text, interval_text, quantity_text, value_text
from labrun.store import Trace

if TYPE_CHECKING:
    from labrun.store import SeenTrial

_COLOURS: dict[State, str] = {
    "starting": "cyan",
    "running": "green",
    "silent": "yellow",
    "dead": "red",
    "stopped": "yellow",
    "finished": "bold green",
}
_SPOILED = {"rejected": "yellow", "failed": "red"}
_BAR_WIDTH = 32
_LINES_BESIDE_PLOT = 20
_MOST_PLOT_WIDTH = 96


def watch(look: Callable[[], Snapshot], console: Console, clock: Clock, every_s: float) -> Snapshot:
    """Show a run until it has finished or Ctrl-C; what stood there last stays.

    Parameters
    ----------
    look
        Returns the run as it is now.
    every_s
        Time between two looks, s. Looks are polls: a network folder tells nobody that it has changed.

    Returns
    -------
    Snapshot
        The last look.
    """
    snapshot = look()
    live = Live(render(snapshot, console), console=console, auto_refresh=False)
    try:
        # Started inside: Ctrl-C during the first drawing, too, must give the cursor back and end well.
        live.start(refresh=True)
        while snapshot.state != "finished":
            clock.sleep(every_s)
            snapshot = look()
            live.update(render(snapshot, console), refresh=True)
    except KeyboardInterrupt:
        pass
    finally:
        live.stop()
    return snapshot


def render(snapshot: Snapshot, console: Console) -> RenderableType:
    """Return a snapshot as rich draws it."""
    lines: list[RenderableType] = [_heading(snapshot), _progress(snapshot), _now(snapshot)]
    if snapshot.reason and snapshot.reason != snapshot.event:
        lines.append(Text(f"  {snapshot.reason}", style=_COLOURS[snapshot.state]))
    if snapshot.resume is not None:
        sure = "to go on" if snapshot.state != "silent" else "if it is dead, go on with"
        lines.append(Text(f"  {sure}: {snapshot.resume}", overflow="fold"))
    lines += [Text(f"  {note}", style="yellow") for note in snapshot.notes]
    lines += _best(snapshot)
    if snapshot.last_trials:
        lines.append(_trials(snapshot))
    if snapshot.trace is not None:
        lines += _plot(snapshot.trace, console)
    return Group(*lines)


def _heading(snapshot: Snapshot) -> Text:
    return Text.assemble(
        (snapshot.title or snapshot.experiment, "bold"), (f"\n{snapshot.run}", "dim"), overflow="fold"
    )


def _progress(snapshot: Snapshot) -> RenderableType:
    counts = [f"{snapshot.trials['done']} done"]
    counts += [f"{count} {status}" for status, count in snapshot.trials.items() if count and status != "done"]
    of = "" if snapshot.expected is None else f" of {snapshot.expected} expected"
    left = "" if snapshot.remaining_s is None else f", {duration_text(snapshot.remaining_s)} left"
    text = Text.assemble(
        (snapshot.state, _COLOURS[snapshot.state]),
        f"  {snapshot.total}{of} trials: {', '.join(counts)}{left}",
    )
    if snapshot.expected is None:
        return text
    row = Table.grid(padding=(0, 1))
    share = min(snapshot.total, snapshot.expected)
    row.add_row(ProgressBar(total=max(snapshot.expected, 1), completed=share, width=_BAR_WIDTH), text)
    return row


def _now(snapshot: Snapshot) -> Text:
    when = ""
    if snapshot.event_utc:
        word = "silent since" if snapshot.state in ("silent", "dead") else "at"
        clock = snapshot.event_utc.partition("T")[2].partition(".")[0]
        when = f"  {word} {clock} UTC, {duration_text(snapshot.quiet_s)} ago"
    return Text.assemble(("  last event   ", "dim"), snapshot.event, (when, "dim"))


def _best(snapshot: Snapshot) -> list[RenderableType]:
    final = snapshot.honest_best
    if final is not None:
        value = interval_text(final.value, final.ci95, final.unit)
        label, name, note = "best", final.objective_name, "95 % interval of fresh repeats"
        condition = condition_text(final.parameters)
    elif snapshot.best is not None:
        best = snapshot.best
        value = quantity_text(best.value, snapshot.units.get(best.objective, ""))
        label, name, note = "best so far", best.objective, f"mean of {best.trials}, not confirmed yet"
        condition = condition_text(best.condition)
    else:
        return []
    return [
        Text.assemble(
            (f"  {label:<13}", "dim"),
            f"{name} ",
            (value, "bold green"),
            f"  at {condition}",
            (f"  ({note})", "dim"),
        )
    ]


def _trials(snapshot: Snapshot) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1))
    newest = snapshot.last_trials
    conditions = list(dict.fromkeys(name for trial in newest for name in trial.condition))
    objectives = list(dict.fromkeys(name for trial in newest for name in trial.objectives))
    for name in ("trial", *conditions, *objectives):
        unit = snapshot.units.get(name, "")
        table.add_column(f"{name} ({unit})" if unit else name, justify="right")
    table.add_column("", overflow="ellipsis", no_wrap=True)
    for trial in newest:
        cells = [value_text(trial.condition[name]) if name in trial.condition else "" for name in conditions]
        cells += [f"{trial.objectives[name]:.4g}" if name in trial.objectives else "" for name in objectives]
        table.add_row(str(trial.index), *cells, _remark(trial))
    return table


def _remark(trial: "SeenTrial") -> Text:
    role = "" if trial.role == "measure" else trial.role
    if trial.status == "done":
        return Text(role, style="dim")
    said = f"{trial.status}: {trial.reason}" if trial.reason else trial.status
    return Text(f"{role} {said}".strip(), style=_SPOILED[trial.status])


def _plot(trace: Trace, console: Console) -> list[RenderableType]:
    unit = f" ({trace.unit})" if trace.unit else ""
    part = "" if trace.whole else ", the end of it"
    title = Text(f"  {trace.channel}{unit} of trial {trace.index}{part}", style="dim")
    finite = trace.values[np.isfinite(trace.values)]
    if len(finite) == 0:
        return [title]
    high, low = f"{finite.max():.3g}", f"{finite.min():.3g}"
    times = f"{trace.time_s[0]:.3g} s", f"{trace.time_s[-1]:.4g} s"
    margin = max(len(high), len(low)) + 2
    if console.options.ascii_only:
        return [Text(f"{title.plain}: {low} to {high}, {times[0]} to {times[1]}")]
    width = max(16, min(_MOST_PLOT_WIDTH, console.width - margin - 2))
    height = int(np.clip(console.height - _LINES_BESIDE_PLOT, 3, 8))
    rows = braille_curve(trace.time_s, trace.values, width, height)
    labels = [high, *[""] * (len(rows) - 2), low]
    drawn = [
        Text.assemble((f"{label:>{margin}} ", "dim"), (row, "cyan"), no_wrap=True)
        for label, row in zip(labels, rows, strict=True)
    ]
    axis = f"{'':{margin + 1}}{times[0]}{times[1]:>{max(1, width - len(times[0]))}}"
    return [title, *drawn, Text(axis, style="dim", no_wrap=True)]
