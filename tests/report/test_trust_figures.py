"""The figures that say how far a run can be believed, and the statistics they draw."""

from xml.etree import ElementTree

import numpy as np
import pytest
from memory_run import MemoryRun, sweep_view

from labrun.report.data import RunView
from labrun.report.figures.trust import draw_drift, draw_repeatability, draw_settling
from labrun.report.statistics import (
    chance_band,
    drift,
    grows_with_size,
    line_band,
    reference_values,
    repeatability,
)
from labrun.report.style import as_svg
from labrun.store import SettleSummary, TrialOutcome

pytestmark = pytest.mark.rendered


def references(count=20, noise=0.05, slope_per_h=0.1, seed=1):
    view = sweep_view(lambda c: 0.0, {"f": [1]})
    rng = np.random.default_rng(seed)
    trials = [
        TrialOutcome(
            k, {"f": 1.0}, 0, "reference", started_s=1000.0 + 600.0 * k, duration_s=1.0,
            objectives={"thrust": 0.5 + slope_per_h * k / 6 + noise * rng.standard_normal()},
        )
        for k in range(count)
    ]  # fmt: skip
    return RunView(MemoryRun(trials), view.experiment, None)


def test_the_line_has_the_slope_that_the_report_states():
    view = references()
    (fitted,) = drift(view)
    hours, values = reference_values(view, "thrust")
    line, _ = line_band(hours, values, np.array([0.0, 1.0]))
    assert hours[0] == 0.0
    assert line[1] - line[0] == pytest.approx(fitted.slope_per_h)


def test_the_band_holds_the_true_line_95_percent_of_the_time():
    at, held = np.array([2.5]), 0
    for seed in range(400):
        line, half = line_band(*reference_values(references(seed=seed), "thrust"), at)
        held += abs(line[0] - (0.5 + 0.1 * at[0])) <= half[0]
    assert held / 400 == pytest.approx(0.95, abs=0.045)


@pytest.mark.parametrize("repeats", [2, 3, 8])
def test_95_percent_of_standard_deviations_lie_in_the_band_of_chance(repeats):
    sds = 0.3 * np.random.default_rng(2).standard_normal((20_000, repeats)).std(axis=1, ddof=1)
    low, high = chance_band(0.3, repeats)
    assert np.mean((sds >= low) & (sds <= high)) == pytest.approx(0.95, abs=0.01)


def test_scatter_that_grows_with_the_value_is_told_and_even_scatter_is_not():
    rng = np.random.default_rng(3)
    means = np.linspace(-1.0, 1.0, 60)
    even = np.abs(0.1 + 0.02 * rng.standard_normal(60))
    assert grows_with_size(means, even) is None
    rising = grows_with_size(means, even + 0.3 * np.abs(means))
    assert rising is not None
    assert rising > 0.5


def drawings():
    view = references()
    swept = sweep_view(lambda c: c["f"], {"f": [1, 2, 3]})
    waits = [TrialOutcome(k, {}, 0, settle=SettleSummary("quiet", 5.0 + k)) for k in range(5)]
    waits.append(TrialOutcome(5, {}, 0, settle=SettleSummary("timeout", 60.0)))
    return {
        "drift": as_svg(draw_drift(view, drift(view))),
        "repeatability": as_svg(draw_repeatability(swept, repeatability(swept)[0])),
        "settling": as_svg(draw_settling(waits)),
    }


def test_figures_are_whole_drawings_that_load_nothing_and_repeat_byte_for_byte():
    first, second = drawings(), drawings()
    assert first == second
    for name, data in first.items():
        root = ElementTree.fromstring(data)
        assert root.tag.endswith("svg"), name
        links = [value for item in root.iter() for key, value in item.attrib.items() if key.endswith("href")]
        assert all(link.startswith("#") for link in links), name


def test_a_run_that_settled_at_once_everywhere_can_be_drawn():
    figure = draw_settling([TrialOutcome(0, {}, 0, settle=SettleSummary("time", 0.0))])
    assert as_svg(figure).startswith(b"<?xml")
