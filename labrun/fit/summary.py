"""The result of a fit that is more than one model beside its data: estimates, tables, files, a figure."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from labrun.fit.estimate import Estimate, parameters_json
from labrun.fit.text import estimate_lines, heading, rmse_lines, table_lines, told_lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class FittedData:
    """What was fitted: name of the run or recording, and how many of its trials."""

    name: str
    kind: Literal["recording", "run"]
    trials: int
    left_out: int = 0


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table worth a look: a title, a heading for each column, rows of text."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def lines(self) -> list[str]:
        """Return it as aligned text."""
        return ["", f"  {self.title}", *table_lines([self.header, *self.rows])]


@dataclass(frozen=True, slots=True)
class FitSummary:
    """What a fit found.

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
        Further files that are written beside the figure: name -> text.
    picture
        Draws the figure; None if there is nothing to draw.
    figure
        Its path, once drawn.
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
    files: Mapping[str, str] = field(default_factory=dict)
    picture: Callable[[], "Figure"] | None = None
    figure: Path | None = None

    @property
    def data_name(self) -> str:
        """Name of the run or recording."""
        return self.data.name

    @property
    def kind(self) -> Literal["recording", "run"]:
        """What the data are."""
        return self.data.kind

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun fit --json`` prints."""
        return {
            "parameters": parameters_json(self.parameters),
            "rmse": dict(self.rmse),
            "figure": None if self.figure is None else str(self.figure),
            "warnings": list(self.warnings),
        }

    def to_text(self, width: int | None = None) -> str:
        """Return what ``labrun fit`` prints; sentences are wrapped at `width`, the terminal's if None."""
        width = shutil.get_terminal_size((100, 24)).columns if width is None else width
        lines = [heading(self.model_name, self.data.name, self.data.trials, self.data.left_out), ""]
        lines += estimate_lines(self.parameters, self.fixed)
        lines += rmse_lines(self.rmse, self.rmse_units)
        for table in self.tables:
            lines += table.lines()
        lines += told_lines(self.findings, self.warnings, width)
        written = (
            {Path(name).suffix.lstrip("."): name for name in self.files} if self.figure is not None else {}
        )
        lines += ["", f"  figure: {self.figure}"] if self.figure is not None else []
        lines += [f"  {kind}: {self.figure.parent / name}" for kind, name in written.items() if self.figure]
        return "\n".join(lines)

    def record(self) -> dict[str, Any]:
        """Return what is stored with the numbers of `to_json`."""
        return {
            "fixed": dict(self.fixed),
            "findings": list(self.findings),
            "tables": [
                {
                    "title": table.title,
                    "header": list(table.header),
                    "rows": [list(row) for row in table.rows],
                }
                for table in self.tables
            ],
            **self.details,
        }

    def draw(self, folder: Path, stem: str) -> "FitSummary":
        """Write figure and files into `folder`."""
        from labrun.store.disk import replace_durably

        for name, text in self.files.items():
            replace_durably(folder / name, text.encode())
        if self.picture is None:
            return self
        path = folder / f"{stem}.png"
        self.picture().savefig(path)
        return replace(self, figure=path)
