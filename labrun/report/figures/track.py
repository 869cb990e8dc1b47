"""The figure of a closed-loop run: reference and feedback, drive, and error of each controller."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrun.arrays import FloatArray
from labrun.experiment import LOOP_DEVICE, loop_channel
from labrun.report.data import RunView
from labrun.report.figures.runs import PANEL_TITLE, condition_title, groups_of, objective_panel
from labrun.report.style import COLOURS, INK, heading, new_figure
from labrun.signals import Signals
from labrun.store import TrialOutcome

_MOST_CONDITIONS = 8
_ACROSS = 4
_MOST_REPEATS = 5
_ROW_IN = 2.75
_MOST_OBJECTIVES = 4
_MOST_TICKS = 120
_OBJECTIVES_IN = 2.5
_ORIENTATION = ("qw", "qx", "qy", "qz")
"""Components of which nobody reads a course: drawn is by how much the feedback is turned from the reference."""


@dataclass(frozen=True, slots=True)
class _Panel:
    """What one pair of axes shows: a loop under one condition."""

    loop: str
    trials: Sequence[TrialOutcome]
    streams: Sequence[Signals]


def draw_track(view: RunView) -> Figure:
    """Draw a closed-loop run.

    For every condition and loop: reference and feedback of its trials, and the variable that the loop sets below; then
    the objectives over all conditions, side by side.
    """
    track = view.experiment.track
    assert track is not None  # noqa: S101  (only runs of kind track are drawn this way)
    groups = list(groups_of(view).values())
    shown = groups[:_MOST_CONDITIONS]
    objectives = _objectives(view)
    bands = max(-(-len(shown) // _ACROSS), 1)
    across = max(-(-len(shown) // bands), 1)
    width_in = max(3.1 * across, 6.4)
    rows = len(track.loops) * bands
    with new_figure(width_in, _ROW_IN * rows + _OBJECTIVES_IN * bool(objectives) + 0.9) as figure:
        heights = [_ROW_IN * rows] + [_OBJECTIVES_IN] * bool(objectives)
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
        grid = parts[0][0].subplots(
            2 * rows, across, sharex=True, sharey="row", squeeze=False, height_ratios=[1.7, 1.0] * rows
        )
        for number, loop in enumerate(track.loops):
            for index in range(bands * across):
                row, column = 2 * (number * bands + index // across), index % across
                above, below = grid[row][column], grid[row + 1][column]
                if index >= len(shown):
                    above.set_visible(False)
                    below.set_visible(False)
                    continue
                _draw(view, _panel(view, loop, shown[index]), above, below, first=column == 0)
                if number == len(track.loops) - 1 and index + across >= len(shown):
                    below.set_xlabel("time (s)")
                    below.tick_params(labelbottom=True)
        if objectives:
            panels = parts[-1][0].subplots(1, len(objectives), squeeze=False)[0]
            for axes, objective in zip(panels, objectives, strict=True):
                width = width_in / len(objectives)
                objective_panel(axes, view, view.points(objective), objective=objective, width_in=width)
            # over all of them: over the first one alone it would push the second away
            parts[-1][0].suptitle(PANEL_TITLE, x=0.01, ha="left", size="medium")
            for axes in panels[1:]:  # all have the first one's conditions
                axes.set_xlabel("")
        heading(figure, view.experiment.title, _subtitle(view, len(groups), len(shown)))
    return figure


def _objectives(view: RunView) -> list[str]:
    """Return the first objectives that have a value, that with the goal before the others."""
    names = sorted(view.experiment.objectives, key=lambda name: name != view.objective)
    return [name for name in names if view.points(name)][:_MOST_OBJECTIVES]


def _panel(view: RunView, loop: str, trials: Sequence[TrialOutcome]) -> _Panel:
    repeats = trials[:_MOST_REPEATS]
    streams = [view.run.signals(trial.index).get(LOOP_DEVICE) for trial in repeats]
    return _Panel(loop, trials, [stream for stream in streams if stream is not None])


def _draw(view: RunView, panel: _Panel, above: Axes, below: Axes, *, first: bool) -> None:
    name = panel.loop
    track = view.experiment.track
    assert track is not None  # noqa: S101  (only runs of kind track are drawn this way)
    loop = track.loops[name]
    shape, streams = loop.shape, panel.streams
    turned = tuple(shape.components) == _ORIENTATION
    if turned:
        for number, stream in enumerate(streams):
            above.plot(
                stream.time_s,
                turned_deg(*(_quaternions(stream, name, signal) for signal in ("feedback", "reference"))),
                color=COLOURS[number % len(COLOURS)],
                linewidth=0.9,
                alpha=0.75,
            )
        above.set_ylim(bottom=0.0)
    shown = () if turned else shape.components
    for axes, quantity, parts in ((above, "feedback", shown), (below, "drive", shape.drives)):
        # colours tell repeats apart; where there are several numbers, these, of the first repeat
        curves = [
            (stream, part) for part in parts for stream in streams[: len(streams) if len(parts) == 1 else 1]
        ]
        for number, (stream, part) in enumerate(curves):
            axes.plot(
                stream.time_s,
                _column(stream, name, quantity, part),
                color=COLOURS[number % len(COLOURS)],
                linewidth=0.9,
                alpha=0.75,
                label=part,
            )
        if len(parts) > 1 and first:
            over = (
                {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98)}
                if axes is below
                else {"loc": "upper right"}
            )
            axes.legend(fontsize=6, ncols=len(parts), frameon=False, borderpad=0.0, borderaxespad=0.0, **over)
    if streams:
        whole = streams[0]
        for part in shown:
            above.plot(
                whole.time_s,
                _column(whole, name, "reference", part),
                color=INK,
                linewidth=1.3,
                ls=(0, (4, 2)),
            )
        above.set_xlim(0, float(whole.time_s[-1]))
    if shape.more and streams:
        _draw_trainings(below, streams[0], name)
    several = len(track.loops) > 1
    above.set_title(condition_title(view, panel.trials[0]) + (f"\nloop {name}" if several else ""))
    if not first:
        return
    if turned:
        above.set_ylabel(f"{name}: error (deg)")
    else:
        above.set_ylabel(f"{name} ({_unit(panel, name, 'feedback', shape.components[0])})")
    driven = "drives" if len(loop.drives) > 1 else loop.drives[0]
    below.set_ylabel(f"{driven} ({_unit(panel, name, 'drive', shape.drives[0])})")


def _quaternions(stream: Signals, loop: str, quantity: str) -> FloatArray:
    return np.column_stack([_column(stream, loop, quantity, part) for part in _ORIENTATION])


def turned_deg(there: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the angles (n,) between orientations (n, 4), deg: of quaternions, whatever their signs and lengths."""
    lengths = np.linalg.norm(there, axis=1) * np.linalg.norm(wanted, axis=1)
    along = np.abs(np.sum(there * wanted, axis=1))
    cosine = np.divide(along, lengths, out=np.full(len(there), np.nan), where=lengths > 0)
    return np.asarray(np.degrees(2.0 * np.arccos(np.clip(cosine, 0.0, 1.0))))


def _draw_trainings(axes: Axes, stream: Signals, loop: str) -> None:
    """Mark on the time axis when new weights came into force; of very many, every so many."""
    column = loop_channel(loop, "trainings")
    if column not in stream.columns:
        return
    came = np.flatnonzero(np.diff(stream.column(column)) > 0) + 1
    shown = stream.time_s[came[:: max(1, len(came) // _MOST_TICKS)]]
    axes.plot(
        shown,
        np.zeros_like(shown),
        "|",
        color=INK,
        markersize=5,
        transform=axes.get_xaxis_transform(),
        clip_on=False,
    )


def _column(stream: Signals, loop: str, quantity: str, part: str) -> FloatArray:
    return np.asarray(stream.column(loop_channel(loop, quantity, part)))


def _unit(panel: _Panel, loop: str, quantity: str, part: str) -> str:
    wanted = loop_channel(loop, quantity, part)
    first = panel.streams[0] if panel.streams else None
    return (first.unit(wanted) if first is not None and wanted in first.columns else "") or "1"


def _subtitle(view: RunView, conditions: int, shown: int) -> str:
    track = view.experiment.track
    rate = f"loop at {track.rate_hz:g} Hz" if track is not None else ""
    accepted = sum(outcome.status == "done" for outcome in view.run.outcomes)
    single = track is not None and all(len(loop.shape.components) == 1 for loop in track.loops.values())
    shapes = [] if track is None else [loop.shape for loop in track.loops.values()]
    turned = any(tuple(shape.components) == _ORIENTATION for shape in shapes)
    text = f"{conditions} conditions, {accepted} accepted trials, {rate}"
    text += "; error: angle between feedback and reference" * turned
    text += "; dashed: the reference" * any(tuple(shape.components) != _ORIENTATION for shape in shapes)
    text += ", colours: repeats" * single
    text += "; ticks: new weights" * any("trainings" in shape.more for shape in shapes)
    return text + (f" (the first {shown} conditions are shown)" if shown < conditions else "")
