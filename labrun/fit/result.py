"""What a fit found, for scripts and for people."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labrun.fit.dataset import Dataset
from labrun.fit.estimate import Estimate, parameters_json
from labrun.fit.text import estimate_lines, heading, rmse_lines, told_lines

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StartOutcome:
    """Where one start of the search ended: RMS residual in units of each channel's own spread."""

    label: str
    parameters: Mapping[str, float]
    misfit: float


@dataclass(frozen=True, slots=True)
class FitResult:
    """A fitted model.

    Attributes
    ----------
    method
        "model" (output error) or "hinge".
    parameters
        Estimates, in the model's order; parameters that were fixed (tolerance 0) are not among them.
    fixed
        Values that were taken as they stand.
    rmse
        Per output channel, in its unit, over all samples of all trials.
    simulated : per trial (n, m)
        Outputs of the fitted model, beside `dataset.trials[i].outputs`.
    initial_states : per trial (k,)
    warnings
        What the data could not determine, and what else a person should know before trusting the numbers.
    figure
        Path of the picture, once drawn.
    findings
        What else the data show, in sentences.
    by_trial
        Estimates of every trial by itself, where the method makes them.
    """

    method: str
    model_name: str
    dataset: Dataset
    parameters: Mapping[str, Estimate]
    fixed: Mapping[str, float]
    rmse: Mapping[str, float]
    simulated: tuple[FloatArray, ...]
    initial_states: tuple[FloatArray, ...]
    warnings: tuple[str, ...] = ()
    starts: tuple[StartOutcome, ...] = field(default=())
    figure: Path | None = None
    findings: tuple[str, ...] = ()
    by_trial: tuple[Mapping[str, float], ...] = ()

    @property
    def data_name(self) -> str:
        """Name of the run or recording."""
        return self.dataset.name

    @property
    def kind(self) -> Literal["recording", "run"]:
        """What the data are."""
        return self.dataset.kind

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """Measured minus simulated, per trial (n, m)."""
        pairs = zip(self.dataset.trials, self.simulated, strict=True)
        return tuple(trial.outputs - simulated for trial, simulated in pairs)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun fit --json`` prints."""
        return {
            "parameters": parameters_json(self.parameters),
            "rmse": dict(self.rmse),
            "figure": None if self.figure is None else str(self.figure),
            "warnings": list(self.warnings),
        }

    def to_text(self, width: int | None = None) -> str:
        """Return what ``labrun fit`` prints: the table, and where the figure is.

        Parameters
        ----------
        width
            Columns to wrap sentences at; those of the terminal if None.
        """
        width = shutil.get_terminal_size((100, 24)).columns if width is None else width
        return self.table(width) + (f"\n\n  figure: {self.figure}" if self.figure is not None else "")

    def table(self, width: int = 100) -> str:
        """Return the estimates as aligned text for a terminal."""
        units = {output.name: output.unit for output in self.dataset.outputs}
        return "\n".join(
            [
                heading(self.model_name, self.dataset.name, len(self.dataset.trials), self.dataset.left_out),
                "",
                *estimate_lines(self.parameters, self.fixed),
                *rmse_lines(self.rmse, units),
                *told_lines(self.findings, self.warnings, width),
            ]
        )

    def record(self) -> dict[str, Any]:
        """Return what is stored with the numbers of `to_json`."""
        return {
            "fixed": dict(self.fixed),
            "findings": list(self.findings),
            "by_trial": [
                {"trial": trial.label, **found}
                for trial, found in zip(self.dataset.trials, self.by_trial, strict=False)
            ],
        }

    def draw(self, folder: Path, stem: str) -> "FitResult":
        """Draw overlay and residuals into ``<folder>/<stem>.png``, and return the result with its figure."""
        from labrun.fit.figure import draw_fit

        return replace(self, figure=draw_fit(self, folder / f"{stem}.png"))
