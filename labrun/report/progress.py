"""The live display of a run in a terminal."""

from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
from rich.text import Text

from labrun.report.text import condition_text, duration_text, quantity_text

if TYPE_CHECKING:
    from labrun.spec import Value
    from labrun.store import TrialOutcome

_REFRESHES_PER_S = 8


class LiveProgress:
    """Shows what is happening now, trials done, time left and the best so far; quiet where nobody watches.

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live.is_started:
            self._live.stop()

    def total(self, trials: int | None) -> None:
        """Set the greatest number of trials there can be."""
        self._bar.update(self._task, total=trials)

    def phase(self, text: str) -> None:
        """Show what is happening now."""
        self._bar.update(self._task, description=text)

    def trial(self, outcome: "TrialOutcome", done: int, total: int | None, remaining_s: float | None) -> None:
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

    def best(self, condition: "Mapping[str, Value]", value: float, unit: str) -> None:
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
