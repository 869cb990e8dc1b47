"""Text of comparisons: a prediction with data, gaits in the laboratory and in the field."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from labrun.experiment import only, varying
from labrun.fit import LEAST_SIZE, ComparedPoint, Comparison, Curve, FigureData, Pair, Panel, Stack
from labrun.report.statistics import root_mean_square
from labrun.report.text import (
    aligned,
    condition_text,
    counted,
    label,
    percent,
    quantity_text,
    spaced,
    value_text,
    with_unit,
)
from labrun.search import NUMBER, Agreement, Ranking

_SHOWN = 12
_OVERLAYS, _ACROSS = 6, 3
_MOST_TICKS = 24
_FEW, _HALF_BAR = 3, 0.2
"""Points of a channel that need no panel of their own; where the bars of a pair stand."""


def comparison_text(comparison: Comparison, width: int) -> str:
    """Return what ``labrun compare`` prints: the worst points, the error of each channel, the verdict."""
    lines = [
        f"{comparison.prediction} held against {comparison.data}: {counted(comparison.trials, 'trial')} "
        f"at {counted(comparison.conditions, 'condition')}, nothing fitted",
        *_alike(comparison),
        "",
    ]
    shown = comparison.points[:_SHOWN]
    several = len(comparison.units()) > 1
    rows = [("worst first", *(["channel"] if several else []), "measured", "predicted", "RMSE", "relative")]
    rows += [
        (_where(comparison, point), *([point.channel] if several else []), *_numbers(point))
        for point in shown
    ]
    lines += [f"  {line}" for line in aligned(rows, words=2 if several else 1)]
    if len(comparison.points) > len(shown):
        lines.append(f"  and {len(comparison.points) - len(shown)} more")
    lines += [f"  {line}" for line in _denominators(comparison, shown)]
    units, errors = comparison.units(), comparison.rmse()
    # else they stand above already
    if len(comparison.points) > len(errors) or len(comparison.points) > len(shown):
        lines += ["", "  root mean square of measured - predicted"]
        lines += [
            f"    {channel}: {quantity_text(value, units[channel])}, {_at_worst(comparison, channel)}"
            for channel, value in errors.items()
        ]
    sentences = [_verdict(comparison), *_over_channels(comparison), *comparison.notes]
    lines.append("")
    for sentence in sentences:
        lines += textwrap.wrap(
            sentence, width, initial_indent="  - ", subsequent_indent="    ", break_on_hyphens=False
        )
    return "\n".join(lines)


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return all numbers of a comparison, the worst point first; what is not finite is None."""
    units = comparison.units()
    return {
        "data": comparison.data,
        "prediction": comparison.prediction,
        "trials": comparison.trials,
        "tolerance": comparison.tolerance,
        "within": comparison.within,
        "worst": _point_json(comparison.worst),
        "channels": {name: {"rmse": value, "unit": units[name]} for name, value in comparison.rmse().items()},
        "points": [_point_json(point) for point in comparison.points],
        "notes": list(comparison.notes),
    }


def comparison_figure(comparison: Comparison) -> FigureData:
    """Return the figure: numbers over conditions, or the signals that are off the most."""
    worst = comparison.worst
    title = (
        f"{comparison.prediction} held against {comparison.data}\n"
        f"Nothing is fitted. Worst: {_relative(worst)}, {worst.channel} at {_where(comparison, worst)}"
    )
    single = all(len(pair.time_s) == 1 for pair in comparison.pairs)
    stacks = _over_conditions(comparison) if single else _overlays(comparison)
    rows = tuple(tuple(stacks[start : start + _ACROSS]) for start in range(0, len(stacks), _ACROSS))
    return FigureData(title, rows, legend="top", row_height_in=3.0)


def _alike(comparison: Comparison) -> list[str]:
    """Return the part of the condition common to all."""
    differing = varying(point.condition for point in comparison.points)
    first = comparison.points[0].condition
    alike = {name: value for name, value in first.items() if name not in differing}
    return [f"all at {condition_text(alike)}"] if alike else []


def _where(comparison: Comparison, point: ComparedPoint) -> str:
    differing = varying(other.condition for other in comparison.points)
    condition = condition_text(only(point.condition, differing)) or "the only condition"
    return condition if point.at_s is None else f"{condition}, at {point.at_s:.3g} s"


def _numbers(point: ComparedPoint) -> tuple[str, ...]:
    sizes = (point.measured, point.predicted, point.rmse)
    return (*(f"{value:.4g}" for value in sizes), _relative(point))


def _relative(point: ComparedPoint) -> str:
    if not math.isfinite(point.relative):
        return "nothing but 0 measured"
    return percent(point.relative) + ("*" if point.floored else "")


def _denominators(comparison: Comparison, shown: Sequence[ComparedPoint]) -> list[str]:
    """Say what errors are relative to: of small values not to these themselves."""
    lines = ["relative: RMSE over the root mean square of what was measured"]
    units = comparison.units()
    least = {point.channel: point.size for point in shown if point.floored}
    if least:
        sizes = ", ".join(
            f"{quantity_text(size, units[channel])} of {channel}" for channel, size in least.items()
        )
        lines.append(
            f"* less than {percent(LEAST_SIZE)} of the channel's greatest value was measured: over that, {sizes}"
        )
    return lines


def _at_worst(comparison: Comparison, channel: str) -> str:
    own = next(point for point in comparison.points if point.channel == channel)
    return f"at worst {_relative(own)} ({_where(comparison, own)})"


def _over_channels(comparison: Comparison) -> list[str]:
    """Say how far all channels are off together, where they have one unit."""
    units, distances = set(comparison.units().values()), comparison.distances()
    if len(units) != 1 or len(distances) < 2:
        return []
    (unit,) = units
    mean, worst = float(np.mean(list(distances.values()))), max(distances, key=distances.__getitem__)
    return [
        f"mean of |measured - predicted| over {len(distances)} channels: {quantity_text(mean, unit)}; "
        f"the largest is {worst}'s, {quantity_text(distances[worst], unit)}"
    ]


def _verdict(comparison: Comparison) -> str:
    worst = comparison.worst
    text = f"worst: {worst.channel} at {_where(comparison, worst)} is off by {_relative(worst)}"
    if comparison.tolerance is None:
        return text
    beyond = sum(point.relative > comparison.tolerance for point in comparison.points)
    limit = f"the tolerance of {100 * comparison.tolerance:g} %"
    if comparison.within:
        return f"{text}, within {limit}"
    return f"{text}, beyond {limit}, as are {beyond} of {len(comparison.points)} points in all"


def _point_json(point: ComparedPoint) -> dict[str, Any]:
    return {**asdict(point), "relative": point.relative if math.isfinite(point.relative) else None}


def _over_conditions(comparison: Comparison) -> list[Stack]:
    """Return a panel for each channel: over the only number that changes, else over the conditions by name.

    Channels of one unit that have few points each share a panel, side by side.
    """
    units = comparison.units()
    channels = {name: [pair for pair in comparison.pairs if pair.channel == name] for name in units}
    stacks = []
    for unit in dict.fromkeys(units.values()):
        own = [pairs for name, pairs in channels.items() if units[name] == unit]
        together = [pair for pairs in own for pair in pairs]
        few = max(len(pairs) for pairs in own) <= _FEW and len(together) <= _MOST_TICKS
        if few and len(own) > 1:
            stacks.append(Stack((_side_by_side(together, unit),), width=max(1.8, 0.12 * len(together))))
        else:
            stacks += [Stack((_condition_panel(pairs),), width=1.5) for pairs in own]
    return stacks


def _side_by_side(pairs: Sequence[Pair], unit: str) -> Panel:
    """Return measured and predicted numbers of several channels, a pair of bars each."""
    places = np.arange(len(pairs), dtype=float)
    alone = len({pair.channel for pair in pairs}) == len(pairs)
    measured = np.array([float(pair.measured[0]) for pair in pairs])
    predicted = np.array([float(pair.predicted[0]) for pair in pairs])
    return Panel(
        (
            Curve(places - _HALF_BAR, measured, "measured", "measured", kind="bars"),
            Curve(places + _HALF_BAR, predicted, "fitted", "predicted", kind="bars"),
        ),
        y_label=unit,
        zero=True,
        ticks=tuple(pair.channel if alone else f"{pair.channel}, {_apart(pairs, pair)}" for pair in pairs),
    )


def _condition_panel(pairs: Sequence[Pair]) -> Panel:
    first = pairs[0]
    names = [name for name in first.condition if len({pair.condition.get(name) for pair in pairs}) > 1]
    apart = [name for name in names if len({pair.condition[name] for pair in pairs}) == len(pairs)]
    along = next((name for name in apart if not isinstance(first.condition[name], str)), None)
    if along is not None:
        pairs = sorted(pairs, key=lambda pair: float(pair.condition[along]))
        places = np.array([float(pair.condition[along]) for pair in pairs])
        ticks: tuple[str, ...] = ()
    else:
        places = np.arange(len(pairs), dtype=float)
        shown = apart[:1] or names or list(first.condition)  # of one condition alone, all of it
        labels = (", ".join(value_text(pair.condition[name]) for name in shown) for pair in pairs)
        ticks = tuple(labels) if len(pairs) <= _MOST_TICKS else ()
    measured = np.array([float(pair.measured[0]) for pair in pairs])
    predicted = np.array([float(pair.predicted[0]) for pair in pairs])
    named = [along] if along is not None else [] if names else list(first.condition)
    line = along is not None and all(after > before for before, after in pairwise(places))
    return Panel(
        (
            Curve(places, measured, "measured", "measured", kind="points"),
            Curve(places, predicted, "fitted", "predicted", kind="line" if line else "points"),
        ),
        title=first.channel,
        x_label=", ".join(label(name, {}) for name in named),
        y_label=with_unit(first.channel, first.unit),
        zero=True,
        ticks=ticks,
    )


def _apart(pairs: Sequence[Pair], of: Pair) -> str:
    """Return the part of a pair's condition that differs from the others, for titles."""
    names = [name for name in of.condition if len({pair.condition.get(name) for pair in pairs}) > 1]
    labels = [
        value if isinstance(value := of.condition[name], str) else f"{spaced(name)} {value_text(value)}"
        for name in names
    ]
    return ", ".join(labels) or of.label


def _overlays(comparison: Comparison) -> list[Stack]:
    """Return measured and predicted signals of the worst points, the difference below."""
    stacks = []
    for point in comparison.points[:_OVERLAYS]:
        own = [
            pair
            for pair in comparison.pairs
            if pair.channel == point.channel and dict(pair.condition) == dict(point.condition)
        ]
        pair = max(own, key=lambda candidate: root_mean_square(candidate.measured - candidate.predicted))
        upper = Panel(
            (
                Curve(pair.time_s, pair.measured, "measured", "measured", bold=True),
                Curve(pair.time_s, pair.predicted, "fitted", "predicted"),
            ),
            title=_apart(comparison.pairs, pair),
            y_label=with_unit(point.channel, point.unit),
            height=2.0,
        )
        lower = Panel(
            (
                Curve(
                    pair.time_s,
                    pair.measured - pair.predicted,
                    "residual",
                    "measured \N{MINUS SIGN} predicted",
                ),
            ),
            note=_relative(point),
            x_label="time, s",
            y_label="difference",
            zero=True,
        )
        stacks.append(Stack((upper, lower)))
    return stacks


def ranking_text(ranking: Ranking) -> str:
    """Return the table of gaits by setting, the agreements, and which gait to take, and why."""
    heads = [condition_text(column.setting) or ranking.objective for column in ranking.columns]
    labs = [Path(path).parent.name for path in ranking.laboratories]
    measured_in = [
        with_unit(lab, ranking.laboratory_units.get(path, ""))
        for path, lab in zip(ranking.laboratories, labs, strict=True)
    ]
    rows = [["gait", *measured_in, *(with_unit(head, ranking.unit) for head in heads)]]
    for index, gait in enumerate(ranking.gaits):
        row = [f"{gait.get(NUMBER, index + 1):g}"]
        for path in ranking.laboratories:
            value = ranking.laboratory_values[path][index]
            row.append("-" if value is None else f"{value:.4g}")
        for column in ranking.columns:
            cell = column.cells[index]
            text = "-" if cell is None else f"{cell.mean:.4g}"
            if cell is not None and cell.ci95 is not None:
                text += f" ({cell.ci95[0]:.4g} to {cell.ci95[1]:.4g})"
            row.append(text)
        rows.append(row)
    lines = [f"{ranking.objective}, mean with 95 % interval; laboratory: mean"]
    lines += [*aligned(rows), ""]
    for path, lab in zip(ranking.laboratories, labs, strict=True):
        for column, head in zip(ranking.columns, heads, strict=True):
            lines += _agreement_lines(column.agreements[path], lab, head)
    lines += [f"note      {note}" for note in ranking.notes]
    lines += _winner_lines(ranking, heads)
    return "\n".join(lines)


def _agreement_lines(agreement: Agreement | None, lab: str, head: str) -> list[str]:
    what = f"{lab} and {head}"
    if agreement is None:
        return [f"{what}: no order to compare: fewer than three gaits in common, or all alike"]
    p = "exact p" if agreement.exact else "p of sampled orders"
    ties = f", {agreement.ties} tied pairs" if agreement.ties else ""
    tau, rho = agreement.tau_ci95, agreement.spearman_ci95
    lines = [
        f"{what}, {agreement.count} gaits{ties}:",
        f"  Kendall tau {agreement.tau:.2f} ({tau[0]:.2f} to {tau[1]:.2f}), {p} = {agreement.tau_p:.3g}; "
        f"Spearman rho {agreement.spearman:.2f} ({rho[0]:.2f} to {rho[1]:.2f}), {p} = {agreement.spearman_p:.3g}",
    ]
    if not agreement.carries_over:
        lines.append(f"  the laboratory's order does not carry over to {head}: the interval of tau covers 0")
    return lines


def _winner_lines(ranking: Ranking, heads: Sequence[str]) -> list[str]:
    if ranking.winner is None:
        return []
    winner = ranking.winner
    bounds = [
        (ranking.bound(column, winner), head) for column, head in zip(ranking.columns, heads, strict=True)
    ]
    sign = 1.0 if ranking.maximise else -1.0
    bound, head = min(((b, h) for b, h in bounds if b is not None), key=lambda item: sign * item[0])
    end, beyond = ("from", "greatest") if ranking.maximise else ("up to", "least")
    why = f"in its worst setting ({head}) its interval goes {end} {bound:.4g} {ranking.unit}, the {beyond} of all gaits"
    return [
        f"take {ranking.name(winner)}: {why}",
        f"          {condition_text(ranking.gaits[winner], ranking.gait_units)}",
    ]
