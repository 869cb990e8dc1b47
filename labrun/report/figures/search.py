"""The figure of a CMA-ES search: convergence, and the confirmed best with its interval."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator

from labrun.report.data import RunView
from labrun.report.figures.runs import cycles_of, draw_cycle, draw_traces
from labrun.report.style import (
    BEST,
    COLOURS,
    FAINT,
    INK,
    SOFT,
    annotate_point,
    heading,
    legend_above,
    new_figure,
    panel_letter,
    plain_numbers,
    zero_line,
)

Generation = Mapping[str, Any]


def draw_search(view: RunView, generations: Sequence[Generation]) -> Figure:
    """Draw a search.

    Single trials lightly, each generation's median and best mean, the honest best with its interval at the end and
    the luckiest trial beside it; the variables, the share of candidates that could run, the step size; the
    recorded traces of the winner.
    """
    trials = view.best_trials
    with new_figure(9.6, 9.0 if trials else 6.6) as figure:
        rows = 3 if trials else 2
        grid = figure.add_gridspec(rows, 6, height_ratios=[1.5, 1.0, 1.0][:rows])
        main = figure.add_subplot(grid[0, :])
        _objective(main, view, generations)
        number = [int(state["generation"]) for state in generations]
        lower = [figure.add_subplot(grid[1, k : k + 2]) for k in (0, 2, 4)]
        _variables(lower[0], view, generations, number)
        _feasible(lower[1], generations, number)
        _step_size(lower[2], generations, number)
        for axes in lower:
            axes.set_xlabel("generation")
            _restarts(axes, generations)
        if trials and view.channel is not None:
            cycles = cycles_of(view, trials, view.channel)
            time_axes = figure.add_subplot(grid[2, :] if cycles is None else grid[2, :4])
            draw_traces(time_axes, view, trials, view.channel)
            panel_letter(time_axes, "e", f"the winner, {len(trials)} trials over each other")
            if cycles is not None:
                cycle_axes = figure.add_subplot(grid[2, 4:])
                draw_cycle(cycle_axes, cycles)
                panel_letter(cycle_axes, "f", "its mean gait cycle, ± sd")
        heading(figure, view.experiment.title, _subtitle(view, generations))
    return figure


def _subtitle(view: RunView, generations: Sequence[Generation]) -> str:
    trials = int(generations[-1]["trials"])
    count = f"{len(generations)} generations, {trials} trials"
    return view.with_best(count)


def _objective(axes: Axes, view: RunView, generations: Sequence[Generation]) -> None:
    maximise = view.experiment.goal is None or view.experiment.goal[1] == "maximise"
    choose = np.max if maximise else np.min
    number, median, best = [], [], []
    for state in generations:
        candidates = [c for c in state["candidates"] if c["value"] is not None]
        single = [value for c in candidates for value in c["values"]]
        where = int(state["generation"])
        axes.plot(
            where + np.linspace(-0.28, 0.28, len(single)),
            single,
            ".",
            color=SOFT,
            markersize=3.2,
            alpha=0.35,
            markeredgewidth=0,
            zorder=1,
        )
        if candidates:
            means = [c["value"] for c in candidates]
            number.append(where)
            median.append(float(np.median(means)))
            best.append(float(choose(means)))
    axes.plot([], [], ".", color=SOFT, markersize=6, alpha=0.6, markeredgewidth=0, label="single trials")
    axes.plot(number, median, "o-", color=COLOURS[0], markersize=3, label="median of generation")
    axes.plot(number, best, "o-", color=COLOURS[2], markersize=3, label="best mean (optimistic)")
    last = int(generations[-1]["generation"])
    width = max(1.2, 0.07 * last) if view.best is not None else 0.0
    _honest(axes, view, last, width)
    _restarts(axes, generations)
    axes.set_xlim(0.3, last + 0.6 + width)
    axes.set_xticks([tick for tick in axes.get_xticks() if 1 <= tick <= last])
    axes.set_xlabel("generation")
    axes.set_ylabel(view.objective_label)
    zero_line(axes)
    panel_letter(axes, "a", "objective")
    legend_above(axes, columnspacing=1.2, handletextpad=0.5)


def _honest(axes: Axes, view: RunView, last: int, width: float) -> None:
    """Plot the confirmed value to the right of the last generation."""
    best = view.best
    if best is None:
        return
    left = last + 0.6
    axes.axvspan(left, left + width, color=FAINT, alpha=0.4, linewidth=0, zorder=0)
    where = left + 0.38 * width
    if best.ci95 is not None:
        errors = [[best.value - best.ci95[0]], [best.ci95[1] - best.value]]
        axes.errorbar(
            where, best.value, yerr=errors, color=BEST, linewidth=1.6, capsize=4, capthick=1.6, zorder=4
        )
    axes.plot(where, best.value, "D", markersize=4.5, color=BEST, zorder=5, label="honest best, 95 %")
    axes.plot(
        left + 0.7 * width,
        best.luckiest,
        "o",
        markersize=5.5,
        markerfacecolor="white",
        markeredgecolor=COLOURS[1],
        zorder=4,
        label="luckiest trial",
    )


def _variables(axes: Axes, view: RunView, generations: Sequence[Generation], number: Sequence[int]) -> None:
    table = view.experiment.search
    if table is None:
        return
    ends: list[tuple[float, str, str]] = []
    for k, (name, variable) in enumerate(table.variables.items()):
        values = np.array([state["mean_condition"][name] for state in generations], dtype=float)
        share = (values - variable.start) / (variable.stop - variable.start)
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(number, share, color=colour)
        ends.append((float(share[-1]), name, colour))
    _end_labels(axes, ends, number[-1])
    axes.set_ylim(-0.03, 1.03)
    axes.set_ylabel("mean, share of range")
    panel_letter(axes, "b", "variables")


def _end_labels(axes: Axes, ends: Sequence[tuple[float, str, str]], last: int) -> None:
    """Name each line at its end, moved apart where they would overlap."""
    gap = 0.085
    places: list[float] = []
    for share, _, _ in sorted(ends):
        places.append(max(share, places[-1] + gap) if places else share)
    excess = max(0.0, places[-1] - 1.0)
    for position, (_, name, colour) in zip(places, sorted(ends), strict=True):
        at = (last, position - excess)
        annotate_point(axes, name, at, va="center", fontsize=7.5, color=colour, annotation_clip=False)


def _feasible(axes: Axes, generations: Sequence[Generation], number: Sequence[int]) -> None:
    share = [100 * float(state["feasible_share"]) for state in generations]
    axes.plot(number, share, color=COLOURS[0])
    axes.fill_between(number, 0, share, color=COLOURS[0], alpha=0.12, linewidth=0)
    axes.set_ylim(0, 103)
    axes.set_ylabel("candidates that may run (%)")
    panel_letter(axes, "c", "feasible share")


def _step_size(axes: Axes, generations: Sequence[Generation], number: Sequence[int]) -> None:
    axes.semilogy(number, [float(state["largest_spread"]) for state in generations], color=COLOURS[0])
    axes.set_ylabel("largest sd, share of range")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    plain_numbers(axes.yaxis)
    panel_letter(axes, "d", "step size")


def _restarts(axes: Axes, generations: Sequence[Generation]) -> None:
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    for before, after in itertools.pairwise(generations):
        if before["restart"] != after["restart"]:
            axes.axvline(int(after["generation"]) - 0.5, color=INK, linewidth=0.7, linestyle=(0, (2, 2)))
