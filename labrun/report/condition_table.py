"""The table of conditions in a terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from labrun.report.conditions import ConditionResult, standard_error, varying
from labrun.report.text import decimal_text, decimals_for, label, value_text

if TYPE_CHECKING:
    from labrun.report.findings import Findings

_ALL_SHOWN = 12
_BEST_SHOWN = 10
_UNBOUNDED = 10_000


def print_conditions(found: "Findings", console: Console) -> None:
    """Print what every condition gave: all of a few, or the most promising of many."""
    if not found.objective_units or not found.conditions:
        return
    shown = _shown(found)
    table = _table(found, shown, " ")
    unbounded = console.options.update(max_width=_UNBOUNDED)
    if console.measure(table, options=unbounded).maximum > console.width:
        table = _table(found, shown, "\n")  # units below the names, so that no number is broken
        table.collapse_padding = True
    console.print(table)
    if len(shown) < found.conditions_total:
        text = f"... of {found.conditions_total} conditions"
        if found.goal is not None:
            text += "; all accepted trials: what leads is on average too good"
        console.print(Text(text), highlight=False)


def _table(found: "Findings", shown: Sequence[ConditionResult], before_unit: str) -> Table:
    names = varying(result.condition for result in found.conditions)
    headed = f"conditions, by {found.goal[0]}" if found.goal is not None else "conditions"
    title = f"{headed}: means ± half their 95 % intervals"
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in names:
        words = any(isinstance(result.condition.get(name), str) for result in shown)
        heading = label(name, found.condition_units).replace(" (", f"{before_unit}(")
        table.add_column(heading, justify="left" if words else "right")
    table.add_column("n", justify="right")
    decimals: dict[str, int | None] = {}
    for name, unit in found.objective_units.items():
        heading = name if unit in ("", "1") else f"{name}{before_unit}({unit})"
        table.add_column(heading, justify="right")
        points = [result.points[name] for result in shown if name in result.points]
        decimals[name] = decimals_for(standard_error(point) for point in points)
    marked = any(result.best for result in shown)
    if marked:
        table.add_column("")
    for result in shown:
        cells = [value_text(result.condition[name]) if name in result.condition else "" for name in names]
        cells.append(str(result.accepted))
        cells += [_mean(result, name, decimals[name]) for name in found.objective_units]
        if marked:
            cells.append("best" if result.best else "")
        table.add_row(*cells, style="green" if result.best else "")
    return table


def _shown(found: "Findings") -> list[ConditionResult]:
    if found.conditions_total <= _ALL_SHOWN:
        return list(found.conditions)
    shown = list(found.conditions[: _BEST_SHOWN if found.goal is not None else _ALL_SHOWN])
    winner = next((result for result in found.conditions if result.best), None)
    if winner is not None and winner not in shown:
        shown[-1] = winner
    return shown


def _mean(result: ConditionResult, objective: str, decimals: int | None) -> str:
    point = result.points.get(objective)
    if point is None:
        return ""
    mean, interval = decimal_text(point.mean, decimals), point.ci95
    return mean if interval is None else f"{mean} ± {decimal_text(interval[1] - point.mean, decimals)}"
