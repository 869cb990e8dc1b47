"""A fit as aligned text for a terminal: the parts that all fits have in common."""

import textwrap
from collections.abc import Mapping, Sequence

from labrun.fit.estimate import Estimate, rounded


def heading(model: str, data: str, trials: int, left_out: int) -> str:
    """Return what was fitted to what."""
    without = f", {left_out} left out" if left_out else ""
    return f"{model} fitted to {data}: {trials} trial{'s' * (trials != 1)}{without}"


def estimate_lines(parameters: Mapping[str, Estimate], fixed: Mapping[str, float]) -> list[str]:
    """Return the table of estimates with intervals, and of the values that were taken as given."""
    rows = [("", "value", "95 % interval", "")]
    for name, estimate in parameters.items():
        value, low, high = rounded(estimate)
        rows.append((name, value, f"{low} ... {high}", estimate.unit))
    rows += [(name, f"{value:.6g}", "as given", "") for name, value in fixed.items()]
    return table_lines(rows, left=(0, 2, 3))


def table_lines(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> list[str]:
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


def rmse_lines(rmse: Mapping[str, float], units: Mapping[str, str]) -> list[str]:
    """Return the root mean square residual of each output; nothing if there is none."""
    if not rmse:
        return []
    return [
        "",
        "  root mean square of measured - simulated",
        *(f"    {name}: {value:.4g} {units.get(name, '')}".rstrip() for name, value in rmse.items()),
    ]


def told_lines(findings: Sequence[str], warnings: Sequence[str], width: int) -> list[str]:
    """Return findings and warnings as wrapped sentences."""
    told = [("- ", finding) for finding in findings] + [("! ", warning) for warning in warnings]
    lines = [""] if told else []
    for mark, sentence in told:
        lines += textwrap.wrap(
            sentence, width, initial_indent=f"  {mark}", subsequent_indent="    ", break_on_hyphens=False
        )
    return lines
