"""The result of a fit, as data and text: estimates, remarks, tables, files, figure."""

import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from labrun.arrays import FloatArray
from labrun.estimate import Estimate, parameters_json, rounded
from labrun.fit.dataset import Dataset
from labrun.fit.signals import SignalSet
from labrun.notebook import as_html

Role = Literal["measured", "fitted", "residual", "alternative", "limit", "point"]


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve of a panel.

    Attributes
    ----------
    x, y : (n,)
    role
        What it shows, or the number of its series: the report gives each a colour of its own.
    label
        In the legend; none if empty.
    kind
        How it is drawn: "points" and "bars" with `spread` as error bars, "band" between its ends.
    spread : two of (n,)
        Lower and upper end.
    bold, dashed
        Of a line.
    """

    x: FloatArray
    y: FloatArray
    role: Role | int = "fitted"
    label: str = ""
    kind: Literal["line", "steps", "points", "bars", "band"] = "line"
    spread: tuple[FloatArray, FloatArray] | None = None
    bold: bool = False
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes.

    Attributes
    ----------
    note
        At the right above the axes.
    x_range, y_range
        What is shown; what the curves need if None.
    log
        Which axes are logarithmic: "", "x" or "xy".
    zero
        Whether a line is drawn at y = 0.
    equal
        Whether a unit is as long on both axes.
    ticks
        Names of the places 0, 1, 2 ... along x.
    shaded
        Part of x that another panel shows enlarged.
    height
        Relative to the other panels of its stack.
    """

    curves: tuple[Curve, ...]
    title: str = ""
    note: str = ""
    x_label: str = ""
    y_label: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: Literal["", "x", "xy"] = ""
    zero: bool = False
    equal: bool = False
    ticks: tuple[str, ...] = ()
    shaded: tuple[float, float] | None = None
    height: float = 1.0


@dataclass(frozen=True, slots=True)
class Stack:
    """Panels above one another; `shared_x` if all have the same x, told below the lowest only."""

    panels: tuple[Panel, ...]
    shared_x: bool = True
    width: float = 1.0


@dataclass(frozen=True, slots=True)
class FigureData:
    """A figure: rows of stacks under a title.

    Attributes
    ----------
    legend
        "panel": in every panel whose curves have labels; "top": once, below the title.
    row_height_in
        Height of each row, inches.
    """

    title: str
    rows: tuple[tuple[Stack, ...], ...]
    legend: Literal["panel", "top"] = "panel"
    row_height_in: float = 3.6


_NOTEBOOK_WIDTH = 100


@dataclass(frozen=True, slots=True)
class FittedData:
    """What was fitted: name of the run or recording, and how many of its trials."""

    name: str
    kind: Literal["recording", "run"]
    trials: int
    left_out: int = 0

    @classmethod
    def of(cls, dataset: Dataset | SignalSet) -> "FittedData":
        """Return what a dataset holds."""
        return cls(dataset.name, dataset.kind, len(dataset.trials), dataset.left_out)


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table worth a look: a title, a heading for each column, rows of text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def lines(self) -> list[str]:
        """Return it as aligned text."""
        return ["", f"  {self.title}", *_aligned([self.header, *self.rows])]


@dataclass(frozen=True, slots=True)
class FitSummary:
    """The result that every fit method returns.

    Attributes
    ----------
    method, model_name, data
        Which fit, of what, to what.
    parameters
        Estimates with 95 % intervals.
    rmse, rmse_units
        Root mean square residual per output, and its unit.
    fixed
        Values that were taken as they stand.
    tables
        What a person compares, shown below the estimates and stored.
    findings, warnings
        Sentences: what the data show, and what to know before trusting the numbers.
    details
        Anything else that is stored, JSON-ready.
    files
        Further files that are written beside the figure: name -> text, or bytes.
    figure_data
        Makes what the figure shows; None if there is nothing to show but what the report knows to draw.
    figure
        Path of the figure, once drawn.
    """

    method: str
    model_name: str
    data: FittedData
    parameters: Mapping[str, Estimate]
    rmse: Mapping[str, float] = field(default_factory=dict)
    rmse_units: Mapping[str, str] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    tables: tuple[TextTable, ...] = ()
    findings: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    figure_data: Callable[[], FigureData] | None = None
    figure: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """Return parameters, rmse, figure and warnings: what ``labrun fit --json`` prints."""
        return {
            "parameters": parameters_json(self.parameters),
            "rmse": dict(self.rmse),
            "figure": None if self.figure is None else str(self.figure),
            "warnings": list(self.warnings),
        }

    def record(self) -> dict[str, Any]:
        """Return what is stored with the numbers of `to_json`, JSON-ready."""
        tables = [
            {"title": table.title, "header": list(table.header), "rows": [list(row) for row in table.rows]}
            for table in self.tables
        ]
        return {"fixed": dict(self.fixed), "findings": list(self.findings), "tables": tables, **self.details}

    def _repr_html_(self) -> str:
        return as_html(self.to_text(_NOTEBOOK_WIDTH), self.figure)

    def to_text(self, width: int | None = None) -> str:
        """Return what ``labrun fit`` prints; sentences are wrapped at `width`, the terminal's if None."""
        width = shutil.get_terminal_size((100, 24)).columns if width is None else width
        data = self.data
        without = f", {data.left_out} left out" if data.left_out else ""
        trials = f"{data.trials} trial{'s' * (data.trials != 1)}{without}"
        lines = [f"{self.model_name} fitted to {data.name}: {trials}", ""]
        if self.parameters or self.fixed:
            lines += _estimate_lines(self.parameters, self.fixed)
        if self.rmse:
            lines += ["", "  root mean square of measured - simulated"]
        for name, value in self.rmse.items():
            lines.append(f"    {name}: {value:.4g} {self.rmse_units.get(name, '')}".rstrip())
        for table in self.tables:
            block = table.lines()
            lines += block[1:] if lines[-1] == block[0] == "" else block
        lines += _sentences(self.findings, self.warnings, width)
        if self.figure is not None:
            lines += ["", f"  figure: {self.figure}"]
            lines += [
                f"  {Path(name).suffix.lstrip('.')}: {self.figure.parent / name}" for name in self.files
            ]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class StartOutcome:
    """Where one start of the search ended: RMS residual in units of each channel's own spread."""

    label: str
    parameters: Mapping[str, float]
    misfit: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FitResult(FitSummary):
    """A fitted model, simulated beside its data.

    Attributes
    ----------
    simulated : per trial (n, m)
        Outputs of the fitted model, beside `dataset.trials[i].outputs`.
    initial_states : per trial (k,)
    starts
        Where each start of the search ended.
    by_trial
        Estimates of every trial by itself, where the method makes them.
    """

    dataset: Dataset
    simulated: tuple[FloatArray, ...]
    initial_states: tuple[FloatArray, ...]
    starts: tuple[StartOutcome, ...] = ()
    by_trial: tuple[Mapping[str, float], ...] = ()

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """Measured minus simulated, per trial (n, m)."""
        pairs = zip(self.dataset.trials, self.simulated, strict=True)
        return tuple(trial.outputs - simulated for trial, simulated in pairs)

    def record(self) -> dict[str, Any]:
        """Return what is stored with the numbers of `to_json`."""
        pairs = zip(self.dataset.trials, self.by_trial, strict=False)
        by_trial = [{"trial": trial.label, **record} for trial, record in pairs]
        return {**FitSummary.record(self), "by_trial": by_trial}


def _estimate_lines(parameters: Mapping[str, Estimate], fixed: Mapping[str, float]) -> list[str]:
    """Return the table of estimates with intervals, and of the values that were taken as given."""
    rows = [("", "value", "95 % interval", "")]
    for name, estimate in parameters.items():
        value, low, high = rounded(estimate)
        rows.append((name, value, f"{low} ... {high}" if estimate.known else "not known", estimate.unit))
    rows += [(name, f"{value:.6g}", "as given", "") for name, value in fixed.items()]
    return _aligned(rows, left=(0, 2, 3)) if len(rows) > 1 else []


def _aligned(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> list[str]:
    """Return rows in columns two spaces apart; the columns of `left` begin flush, the others end so."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            f"{cell:<{width}}" if column in left else f"{cell:>{width}}"
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(f"  {'  '.join(cells)}".rstrip())
    return lines


def _sentences(findings: Sequence[str], warnings: Sequence[str], width: int) -> list[str]:
    """Return findings and warnings, wrapped."""
    marked = [("- ", finding) for finding in findings] + [("! ", warning) for warning in warnings]
    lines = [""] if marked else []
    for mark, sentence in marked:
        lines += textwrap.wrap(
            sentence, width, initial_indent=f"  {mark}", subsequent_indent="    ", break_on_hyphens=False
        )
    return lines
