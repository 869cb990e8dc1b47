"""Live displays in a terminal: of the run that this process carries out, and of one that is carried out elsewhere."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from labrun.arrays import FloatArray
from labrun.devices import Clock
from labrun.experiment import Condition
from labrun.report.text import (
    condition_text,
    duration_text,
    interval_text,
    quantity_text,
    value_text,
    with_unit,
)
from labrun.runner import SilentProgress
from labrun.search import Best, BestYet
from labrun.store import Trace, TrialOutcome

_REFRESHES_PER_S = 8


class LiveProgress(SilentProgress):
    """Shows the current step, trials done, time left and the best so far; silent without a terminal.

    Implements `labrun.runner.Progress`. Use it as a context manager: the display appears on entering and
    what stands in it at the end stays. Everything goes to standard error, so that standard output is left
    to results.

    Parameters
    ----------
    console
        Where to draw; standard error if None.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=32),
            MofNCompleteColumn(),
            TextColumn("trials at most"),
            TextColumn("{task.fields[left]}", style="cyan"),
            console=self._console,
        )
        self._task = self._bar.add_task("starting", total=None, left="")
        self._best: Text | None = None
        self._last: Text | None = None
        self._spoiled = {"rejected": 0, "failed": 0}
        self._live = Live(
            get_renderable=self._render,
            console=self._console,
            refresh_per_second=_REFRESHES_PER_S,
            transient=True,
        )

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live.is_started:
            self._live.stop()

    def total(self, trials: int | None) -> None:
        """Set the greatest number of trials there can be."""
        self._bar.update(self._task, total=trials)

    def phase(self, text: str) -> None:
        """Show the current step."""
        self._bar.update(self._task, description=text)

    def trial(self, outcome: TrialOutcome, done: int, total: int | None, remaining_s: float | None) -> None:
        """Count a trial, and show it."""
        left = "" if remaining_s is None else f"at most {duration_text(remaining_s)} left"
        self._bar.update(self._task, completed=done, total=total, left=left)
        values = ", ".join(f"{name} {value:.4g}" for name, value in outcome.objectives.items())
        line = Text.assemble(
            ("  last trial  ", "dim"), condition_text(outcome.condition), "  ", (values, "bold")
        )
        if outcome.status != "done":
            self._spoiled[outcome.status] += 1
            line.append(f"  {outcome.status}: {outcome.reason}", style="yellow")
        self._last = line

    def best(self, condition: Condition, value: float, unit: str) -> None:
        """Show the best so far."""
        self._best = Text.assemble(
            ("  best so far ", "dim"),
            (quantity_text(value, unit), "bold green"),
            "  at ",
            condition_text(condition),
        )

    def note(self, text: str) -> None:
        """Print a line that stays."""
        if self._console.is_terminal:
            self._console.print(Text(text), highlight=False)

    def _render(self) -> RenderableType:
        lines: list[RenderableType] = [self._bar]
        lines += [line for line in (self._best, self._last) if line is not None]
        spoiled = ", ".join(f"{count} {status}" for status, count in self._spoiled.items() if count)
        if spoiled:
            lines.append(Text(f"  {spoiled}", style="yellow"))
        return Group(*lines)


class PlainProgress(SilentProgress):
    """Prints notes (a fault that was skipped, why a search ended) to standard error; quiet otherwise."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(f"labrun: {text}", file=sys.stderr, flush=True)


State = Literal["starting", "running", "silent", "dead", "stopped", "finished"]
_OF_TRIAL = ("index", "condition", "repeat", "role", "status", "reason", "objectives")
"""What a script is told of each of the last trials."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A run at one moment.

    Attributes
    ----------
    state
        "silent": nothing was written for long, and nobody knows why; "dead": its process is gone; "stopped": it ended
        early and said so.
    reason
        Why it is not running.
    trials
        Number of trials by status.
    expected
        Number of trials in all; None if nobody can know.
    event, event_utc
        What happened last, in words, and when by the clock of the machine that runs.
    quiet_s
        How long ago that was.
    last_trials
        The latest, newest first.
    best, honest_best
        Best so far, and the confirmed one of a finished run.
    units
        Of conditions and objectives.
    resume
        The command that goes on with a run that came to a stop, or may have.
    """

    run: Path
    experiment: str
    title: str
    state: State
    reason: str
    trials: dict[str, int]
    expected: int | None
    remaining_s: float | None
    event: str
    event_utc: str | None
    quiet_s: float
    last_trials: tuple[TrialOutcome, ...]
    best: BestYet | None
    honest_best: Best | None
    trace: Trace | None
    units: dict[str, str]
    resume: str | None
    notes: tuple[str, ...]

    @property
    def total(self) -> int:
        """Number of trials so far."""
        return sum(self.trials.values())

    def to_json(self) -> dict[str, Any]:
        """Return what `labrun watch --json` prints."""
        best, trace = self.best, self.trace
        return {
            "run": str(self.run),
            "experiment": self.experiment,
            "title": self.title,
            "state": self.state,
            "reason": self.reason,
            "trials": self.trials,
            "expected": self.expected,
            "remaining_s": self.remaining_s,
            "last_event": {"text": self.event, "time_utc": self.event_utc, "ago_s": self.quiet_s},
            "best_so_far": best
            and {
                "parameters": best.condition,
                "objective": {
                    "name": best.objective,
                    "value": best.value,
                    "unit": self.units.get(best.objective, ""),
                },
                "trials": best.trials,
            },
            "best": None if self.honest_best is None else self.honest_best.to_json(),
            "last_trials": [{key: getattr(trial, key) for key in _OF_TRIAL} for trial in self.last_trials],
            "trace": trace
            and {
                "trial": trace.index,
                "channel": trace.channel,
                "unit": trace.unit,
                "samples": len(trace.values),
                "from_s": float(trace.time_s[0]),
                "to_s": float(trace.time_s[-1]),
                "minimum": float(trace.values.min()),
                "mean": float(trace.values.mean()),
                "maximum": float(trace.values.max()),
                "whole": trace.whole,
            },
            "units": self.units,
            "resume": self.resume,
            "notes": list(self.notes),
        }


def event_text(event: dict[str, Any] | None) -> str:
    """Say in words what an event of the journal tells."""
    if event is None:
        return "nothing yet"
    kind, index = event["event"], event.get("index")
    reason = event.get("reason") or event.get("cause") or ""
    texts = {
        "created": "the run was made",
        "expected": "the plan stands",
        "baseline": "measured how still the bench is",
        "resumed": "resumed",
        "prepare": f"trial {index}: moves to its start and settles",
        "record": f"trial {index}: recording",
        "safe-pose": f"trial {index}: moves to the safe pose",
        "trial": f"trial {index}: stored, {event.get('status')}",
        "mark": f"trial {index}: {event.get('status')}, {reason}",
        "damaged": f"trial {index}: its file is damaged, it counts as not run",
        "stopped": f"actuators stopped: {reason}",
        "packed": "run.h5 is written",
        "finished": "finished",
        "interrupted": f"interrupted: {reason}",
        "failed": f"failed: {reason}",
        "limit-reached": f"stopped after {event.get('limit')} new trials, as --limit asked",
    }
    return texts.get(kind, str(kind)).splitlines()[0]


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
    heading = Text.assemble(
        (snapshot.title or snapshot.experiment, "bold"), (f"\n{snapshot.run}", "dim"), overflow="fold"
    )
    lines: list[RenderableType] = [heading, _progress(snapshot), _now(snapshot)]
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
        table.add_column(with_unit(name, snapshot.units.get(name, "")), justify="right")
    table.add_column("", overflow="ellipsis", no_wrap=True)
    for trial in newest:
        cells = [value_text(trial.condition[name]) if name in trial.condition else "" for name in conditions]
        cells += [f"{trial.objectives[name]:.4g}" if name in trial.objectives else "" for name in objectives]
        table.add_row(str(trial.index), *cells, _remark(trial))
    return table


def _remark(trial: TrialOutcome) -> Text:
    role = "" if trial.role == "measure" else trial.role
    if trial.status == "done":
        return Text(role, style="dim")
    text = f"{trial.status}: {trial.reason}" if trial.reason else trial.status
    return Text(f"{role} {text}".strip(), style=_SPOILED[trial.status])


def _plot(trace: Trace, console: Console) -> list[RenderableType]:
    part = "" if trace.whole else ", the end of it"
    title = Text(f"  {with_unit(trace.channel, trace.unit)} of trial {trace.index}{part}", style="dim")
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


_BLANK = 0x2800
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bit of each dot of a character, rows from top to bottom (Unicode 16, block U+2800)."""


def braille_curve(time_s: FloatArray, values: FloatArray, width: int, height: int) -> list[str]:
    """Draw values over time.

    Every column of dots spans what the samples within it do, so that no peak is lost however many there are.

    Parameters
    ----------
    time_s : (n,)
        Increasing.
    values : (n,)
        Values that are not finite are left out.
    width, height
        In characters.

    Returns
    -------
    list of str
        One text of `width` characters a row, from top to bottom; the first is at the largest value, the last at
        the smallest. Empty if there is nothing to draw.
    """
    finite = np.isfinite(values) & np.isfinite(time_s)
    time_s, values = time_s[finite], values[finite]
    if len(values) == 0:
        return []
    columns, rows = 2 * width, 4 * height
    low, high = float(values.min()), float(values.max())
    span_s = float(time_s[-1] - time_s[0])
    share = (time_s - time_s[0]) / span_s if span_s > 0 else np.zeros(len(time_s))
    column = np.minimum((share * columns).astype(int), columns - 1)
    level = (values - low) / (high - low) if high > low else np.full(len(values), 0.5)
    row = np.rint((1.0 - level) * (rows - 1)).astype(int)
    top = np.full(columns, rows)
    bottom = np.full(columns, -1)
    np.minimum.at(top, column, row)
    np.maximum.at(bottom, column, row)
    dots = np.zeros((rows, columns), dtype=bool)
    for left, right in _neighbours(np.flatnonzero(bottom >= 0)):
        _connect(dots, left, (top[left], bottom[left]), right, (top[right], bottom[right]))
    characters = dots.reshape(height, 4, width, 2).transpose(0, 2, 1, 3)
    codes = _BLANK + (characters * _DOTS).sum(axis=(2, 3))
    return ["".join(map(chr, line)) for line in codes]


def _neighbours(filled: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Return each column with samples beside the next one; the last beside itself."""
    return list(zip(filled.tolist(), [*filled[1:].tolist(), int(filled[-1])], strict=True))


def _connect(
    dots: NDArray[np.bool_], left: int, left_span: tuple[int, int], right: int, right_span: tuple[int, int]
) -> None:
    """Draw a column's span, and a line from its middle to the next one's where columns between are empty."""
    first, last = left_span
    if right == left + 1:  # meet the neighbour, so that a steep curve stays one line
        first, last = min(first, right_span[1]), max(last, right_span[0])
    dots[first : last + 1, left] = True
    between = np.arange(left + 1, right)
    start, end = sum(left_span) / 2, sum(right_span) / 2
    dots[np.rint(np.interp(between, [left, right], [start, end])).astype(int), between] = True
