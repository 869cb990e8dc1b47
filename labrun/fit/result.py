"""What a fit found, for scripts and for people."""

import shutil
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.fit.dataset import Dataset

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted number with its 95 % interval, in its unit."""

    value: float
    ci95: tuple[float, float]
    unit: str

    @property
    def contains_zero(self) -> bool:
        """Tell whether the interval cannot tell the number from zero."""
        return self.ci95[0] <= 0.0 <= self.ci95[1]


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
    def residuals(self) -> tuple[FloatArray, ...]:
        """Measured minus simulated, per trial (n, m)."""
        pairs = zip(self.dataset.trials, self.simulated, strict=True)
        return tuple(trial.outputs - simulated for trial, simulated in pairs)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun fit --json`` prints."""
        parameters = {
            name: {"value": estimate.value, "ci95": list(estimate.ci95), "unit": estimate.unit}
            for name, estimate in self.parameters.items()
        }
        return {
            "parameters": parameters,
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
        trials = len(self.dataset.trials)
        left_out = f", {self.dataset.left_out} left out" if self.dataset.left_out else ""
        lines = [
            f"{self.model_name} fitted to {self.dataset.name}: {trials} trial{'s' * (trials != 1)}{left_out}",
            "",
        ]
        rows = [("", "value", "95 % interval", "")]
        for name, estimate in self.parameters.items():
            value, low, high = rounded(estimate)
            rows.append((name, value, f"{low} ... {high}", estimate.unit))
        rows += [(name, f"{value:.6g}", "as given", "") for name, value in self.fixed.items()]
        widths = [max(len(row[column]) for row in rows) for column in range(3)]
        for name, value, interval, unit in rows:
            lines.append(
                f"  {name:<{widths[0]}}  {value:>{widths[1]}}  {interval:<{widths[2]}}  {unit}".rstrip()
            )
        lines += ["", "  root mean square of measured - simulated"]
        for output in self.dataset.outputs:
            lines.append(f"    {output.name}: {self.rmse[output.name]:.4g} {output.unit}")
        told = [("- ", finding) for finding in self.findings] + [("! ", warning) for warning in self.warnings]
        if told:
            lines.append("")
        for mark, sentence in told:
            lines += textwrap.wrap(
                sentence, width, initial_indent=f"  {mark}", subsequent_indent="    ", break_on_hyphens=False
            )
        return "\n".join(lines)


def rounded(estimate: Estimate) -> tuple[str, str, str]:
    """Return value and interval with the digits the interval supports: two of its half-width."""
    low, high = estimate.ci95
    half = 0.5 * (high - low)
    if half <= 0 or not np.isfinite(half):
        return f"{estimate.value:.6g}", f"{low:.6g}", f"{high:.6g}"
    largest = max(abs(estimate.value), abs(low), abs(high))
    digits = int(np.clip(np.floor(np.log10(largest)) - np.floor(np.log10(half)) + 2, 2, 9))
    if 1e-3 <= largest < 1e6:
        decimals = max(int(digits - 1 - np.floor(np.log10(largest))), 0)
        return f"{estimate.value:.{decimals}f}", f"{low:.{decimals}f}", f"{high:.{decimals}f}"
    return f"{estimate.value:.{digits - 1}e}", f"{low:.{digits - 1}e}", f"{high:.{digits - 1}e}"
