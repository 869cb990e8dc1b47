"""Figures of fits: which trials they show, and that nothing of them is cut."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from swings import dataset_of, swing

from labrun.fit import Curve, FigureData, FitResult, FittedData, Panel, Stack
from labrun.report.figures.fits import draw_figure, fit_figure, shown_trials

pytestmark = pytest.mark.rendered


def everything_is_on_the_page(figure: Figure) -> None:
    """Every label and title lies inside the figure."""
    width, height = figure.get_size_inches() * figure.dpi
    renderer = figure.canvas.get_renderer()
    for box in (axes.get_tightbbox(renderer) for axes in figure.axes):
        assert box.x0 >= 0
        assert box.y0 >= 0
        assert box.x1 <= width
        assert box.y1 <= height


def test_the_figure_shows_the_worst_and_the_best_trial() -> None:
    misfit = np.array([3.0, 1.0, 9.0, 2.0, 5.0, 4.0, 0.5, 6.0])
    shown, marks = shown_trials(misfit, most=6)
    assert len(shown) == 6
    assert shown == sorted(shown)
    assert marks == {2: "worst", 6: "best"}
    assert shown_trials(np.array([1.0])) == ([0], {})


@pytest.mark.parametrize("trials", [1, 4, 9])
def test_any_number_of_trials_and_outputs_can_be_drawn(trials: int) -> None:
    single = dataset_of([swing(0.5, duration_s=1.0, rate_hz=50.0)] * trials)
    double = replace(
        single,
        outputs=(single.outputs[0], replace(single.outputs[0], name="force", unit="N")),
        trials=tuple(replace(trial, outputs=np.repeat(trial.outputs, 2, axis=1)) for trial in single.trials),
    )
    for dataset in (single, double):
        names = [output.name for output in dataset.outputs]
        simulated = tuple(0.9 * trial.outputs for trial in dataset.trials)
        result = FitResult(
            method="model",
            model_name="m",
            data=FittedData.of(dataset),
            parameters={},
            rmse=dict.fromkeys(names, 0.05),
            dataset=dataset,
            simulated=simulated,
            initial_states=(),
        )
        figure = fit_figure(result)
        assert figure is not None
        assert len(figure.axes) == 2 * len(names) * min(trials, 6)
        everything_is_on_the_page(figure)


def test_what_a_fit_describes_as_data_is_drawn_with_nothing_cut() -> None:
    x = np.linspace(0.1, 10.0, 50)
    ends = (x - 1.0, x + 1.0)
    curves = (
        Curve(x, x, "measured", "measured", bold=True),
        Curve(x, x, "fitted", "a band", "band", ends),
        Curve(x, x, 3, "given", "steps", dashed=True),
        Curve(x, x, "point", "points", "points", ends),
    )
    bars = Curve(np.arange(3.0), np.ones(3), "residual", "error", "bars", (np.zeros(3), np.full(3, 2.0)))
    upper = Panel(curves, title="a title that is far too long for its panel " * 4, y_label="y, N", log="xy")
    rows = (
        (Stack((upper, Panel((curves[0],), note="RMS 1 N", x_label="time, s", zero=True))),),
        (Stack((Panel((bars,), ticks=("a long name", "another name", "+a^3,b^3\ncond 3e+09")),)),),
    )
    figure = draw_figure(FigureData("A fit\nof something", rows))
    assert len(figure.axes) == 3
    assert [len(axes.lines) for axes in figure.axes[:2]] != [0, 0]
    everything_is_on_the_page(figure)


def test_a_legend_of_many_entries_takes_more_lines_and_stays_within_the_figure() -> None:
    names = [f"activation {number}, lbfgs" for number in range(9)]
    x = np.arange(3.0)
    panel = Panel(tuple(Curve(x, x + number, number, name) for number, name in enumerate(names)))
    figure = draw_figure(FigureData("many", ((Stack((panel,)),),), legend="top", row_height_in=3.0))
    (legend,) = figure.legends
    figure.draw_without_rendering()
    around = legend.get_window_extent()
    assert around.x1 <= figure.bbox.width
    assert around.y0 >= figure.axes[0].get_window_extent().y1
    assert [text.get_text() for text in legend.get_texts()] == names


def test_a_logarithmic_axis_within_a_decade_has_numbers() -> None:
    x = np.array([1.0, 10.0, 100.0])
    panel = Panel((Curve(x, np.array([1.7, 3.0, 4.4])),), log="xy")
    figure = draw_figure(FigureData("narrow", ((Stack((panel,)),),), row_height_in=3.0))
    figure.draw_without_rendering()
    axes = figure.axes[0]
    written = {tick.get_text() for tick in axes.yaxis.get_ticklabels(which="both")} - {""}
    assert {"2", "3", "4"} <= written
    assert {tick.get_text() for tick in axes.xaxis.get_ticklabels(which="both")} >= {"1", "10", "100"}
