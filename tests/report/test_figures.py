from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from memory_run import MemoryRun, sweep_view

from labrun.report.data import RunView
from labrun.report.figures.runs import cycles_of, draw_plain_run, draw_traces, folded_cycle
from labrun.report.figures.search import draw_search
from labrun.report.figures.sweep import Axis, axes_of, best_over_others, draw_sweep, map_colours, most_telling
from labrun.report.style import DIVERGING, SEQUENTIAL, save_figure

pytestmark = pytest.mark.rendered
GRID = {"from": 0, "to": 10, "step": 2.5}


def ridge(c):
    return 0.5 - 0.1 * abs(c["f"] - 4) + 0.02 * c.get("a", 0) - 0.03 * abs(c.get("b", 0))


def is_a_picture(figure):
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())
    assert pixels.shape[0] > 250
    assert pixels.shape[1] > 600
    assert np.ptp(pixels[..., :3]) > 120


@pytest.mark.parametrize(
    "axes",
    [
        {"f": GRID},
        {"f": GRID, "a": GRID},
        {"f": GRID, "a": GRID, "b": [-2, 0, 2]},
        {"f": GRID, "a": GRID, "b": [-2, 0, 2], "fin": ["soft", "stiff"]},
        {"f": GRID, "fin": ["soft", "stiff"]},
        {"f": [4]},
    ],
    ids=["curve", "map", "panels", "best-over-others", "words", "one-condition"],
)
def test_a_sweep_over_any_number_of_parameters_has_its_picture(axes):
    view = sweep_view(ridge, axes, units={"f": "Hz", "a": "deg", "b": "deg"})
    is_a_picture(draw_sweep(view))


@pytest.mark.parametrize("names", [["f", "a"], ["f", "a", "b"]])
def test_a_scattered_design_has_its_picture(names):
    axes = {name: {"from": 0, "to": 10} for name in names}
    view = sweep_view(ridge, axes, design="sobol", samples=64, repeats=1)
    is_a_picture(draw_sweep(view))


def test_a_plain_run_has_its_picture():
    is_a_picture(draw_plain_run(sweep_view(ridge, {"f": [1, 2, 3, 4]}, kind="run")))


@pytest.mark.parametrize("slow_s", [1.25, 4.0])
def test_trials_share_an_axis_of_time_unless_one_is_much_longer_which_is_drawn_over_the_cycle(slow_s):
    view = sweep_view(ridge, {"f": [1, 2]}, kind="run")
    periods_s = {1: 1.0, 2: slow_s}
    view.run.outcomes = [
        replace(
            outcome,
            duration_s=3 * periods_s[outcome.condition["f"]],
            period_s=periods_s[outcome.condition["f"]],
        )
        for outcome in view.run.outcomes
    ]
    panels = draw_plain_run(RunView(view.run, view.experiment, None)).subfigs[0].axes
    ends = [max(line.get_xdata()[-1] for line in axes.lines[:3]) for axes in panels]
    if slow_s > 2:
        assert [axes.get_xlim() for axes in panels] == [(0, 1)] * 2
        assert max(ends) < 1
    else:
        assert [axes.get_xlim() for axes in panels] == [(0, 3 * slow_s)] * 2
        assert ends == pytest.approx([3, 3 * slow_s], abs=0.02)


def test_a_picture_is_whole_or_absent(tmp_path):
    save_figure(draw_sweep(sweep_view(ridge, {"f": GRID})), tmp_path / "figure.png")
    assert [path.name for path in tmp_path.iterdir()] == ["figure.png"]


def generation(number, restart=0):
    rng = np.random.default_rng(number)
    values = rng.normal(0.1 * number, 0.2, (6, 2))
    candidates = [{"value": float(v.mean()), "values": v.tolist(), "feasible": True} for v in values]
    candidates.append({"value": None, "values": [], "feasible": False})
    return {
        "generation": number,
        "restart": restart,
        "trials": 12 * number,
        "mean_condition": {"a": 5 - 5 / number, "f": 3 + 2 / number},
        "feasible_share": min(1.0, 0.2 * number),
        "largest_spread": 0.4 / number,
        "candidates": candidates,
    }


def search_view():
    from labrun.experiment import CmaEs

    view = sweep_view(ridge, {"f": GRID, "a": GRID})
    table = CmaEs.model_validate({"variables": {"a": {"from": 0, "to": 10}, "f": {"from": 0, "to": 10}}})
    experiment = view.experiment.model_copy(update={"kind": "cmaes", "cmaes": table})
    return RunView(view.run, experiment, view.best)


@pytest.mark.parametrize("count", [1, 12])
def test_a_search_has_its_picture_after_one_generation_and_after_many(count):
    generations = [generation(k, restart=k > 8) for k in range(1, count + 1)]
    is_a_picture(draw_search(search_view(), generations))


def test_a_generation_in_which_nothing_could_run_does_not_break_the_picture():
    nothing = {
        **generation(1),
        "candidates": [{"value": None, "values": [], "feasible": False}],
        "feasible_share": 0.0,
    }
    is_a_picture(draw_search(search_view(), [nothing, generation(2)]))


def test_axes_are_what_varies_and_cells_lie_around_their_values():
    points = sweep_view(ridge, {"f": [1, 2, 4], "a": [5]}).points("thrust")
    (axis,) = axes_of(points)
    assert axis.name == "f"
    assert axis.edges.tolist() == [0.5, 1.5, 3.0, 5.0]
    assert [axis.bin_of({"f": value}) for value in (1.0, 4.0, 3.0)] == [0, 2, -1]


def test_the_most_telling_axes_are_those_the_objective_follows():
    axes = {"f": GRID, "a": GRID, "b": [-5, 0, 5], "idle": [1, 2, 3]}
    points = sweep_view(lambda c: c["f"] + 2 * c["a"] - abs(c["b"]), axes, noise=0.0, repeats=1).points(
        "thrust"
    )
    shown = most_telling(points, axes_of(points), 3)
    assert [axis.name for axis in shown] == ["f", "a", "b"]


def test_a_cell_that_stands_for_several_conditions_shows_the_best_of_them():
    points = sweep_view(lambda c: c["f"] + c["a"], {"f": [1, 2], "a": [0, 5]}, noise=0.0).points("thrust")
    axis = Axis("f", (1.0, 2.0), is_grid=True)
    assert sorted(p.mean for p in best_over_others(points, [axis], maximise=True)) == [6.0, 7.0]
    assert sorted(p.mean for p in best_over_others(points, [axis], maximise=False)) == [1.0, 2.0]


@given(rate_hz=st.sampled_from([20.0, 62.5, 100.0, 500.0]), level=st.floats(-2, 2))
def test_a_folded_cycle_keeps_mean_and_shape_at_any_sample_rate(rate_hz, level):
    view = sweep_view(lambda c: level, {"f": [1]}, noise=0.0, repeats=1)
    run = MemoryRun(view.run.outcomes, rate_hz=rate_hz)
    view = RunView(run, view.experiment, view.best)
    cycle = folded_cycle(view, run.outcomes[0], "wrench.force_x")
    assert cycle.mean() == pytest.approx(level, abs=0.06)
    phase = (np.arange(len(cycle)) + 0.5) / len(cycle)
    assert np.corrcoef(cycle, np.sin(4 * np.pi * phase))[0, 1] > 0.9


@pytest.mark.parametrize(("speed", "travels"), [(0.0, False), (0.05, False), (1.0, True), (-1.0, True)])
def test_a_channel_that_goes_on_from_cycle_to_cycle_has_no_mean_cycle(speed, travels):
    view = sweep_view(lambda c: 0.0, {"f": [1]}, noise=0.0, repeats=1)
    run = MemoryRun(view.run.outcomes)
    period_s = run.outcomes[0].period_s
    swinging = run.signals

    def travelling(index):
        force = swinging(index)["wrench"]
        values = force.values + (speed * force.time_s / period_s)[:, None]
        return {"wrench": replace(force, values=values)}

    run.signals = travelling
    view = RunView(run, view.experiment, view.best)
    assert (cycles_of(view, run.outcomes, "wrench.force_x") is None) == travels


@pytest.mark.parametrize(("lift", "colours"), [(0.0, DIVERGING), (5.0, SEQUENTIAL), (-5.0, SEQUENTIAL)])
def test_only_an_objective_of_both_signs_has_colours_on_either_side_of_zero(lift, colours):
    view = sweep_view(lambda c: c["f"] - 5 + lift, {"f": GRID, "a": GRID}, noise=0.0, repeats=1)
    chosen, scale = map_colours(view.points("thrust"))
    assert chosen == colours
    assert (scale.vmin, scale.vmax) == ((-5.0, 5.0) if colours == DIVERGING else (lift - 5, lift + 5))


def test_a_run_without_a_sensor_has_no_empty_picture():
    view = sweep_view(ridge, {"f": [1]}, kind="run")
    view.run.signals = lambda index: {}
    experiment = view.experiment.model_copy(update={"objectives": {}})
    assert draw_plain_run(RunView(view.run, experiment, None)) is None


def test_a_trace_stops_where_cycles_were_not_kept():
    from types import SimpleNamespace

    from matplotlib.figure import Figure

    time_s = np.concatenate([np.arange(0.0, 1.0, 0.05), np.arange(100.0, 101.0, 0.05)])
    view = SimpleNamespace(trace=lambda *_: (time_s, np.sin(time_s)), trace_label="torque")
    trial = SimpleNamespace(duration_s=101.0, period_s=None, discard_cycles=0)
    axes = Figure().subplots()
    draw_traces(axes, view, [trial], "torque")
    drawn = axes.lines[0].get_xdata()
    assert np.count_nonzero(np.isnan(drawn)) == 1
    assert np.nanmax(np.diff(drawn)) < 0.06
