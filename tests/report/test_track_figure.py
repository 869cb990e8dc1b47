"""The picture and the findings of a closed-loop run, from a short dry run."""

import numpy as np
import pytest

from labrun.app.carry_out import draw
from labrun.app.report import read_findings
from labrun.report.data import RunView, experiment_of
from labrun.report.figures.track import turned_deg
from labrun.report.run_page import report_page
from labrun.report.timing import LoopHealth, loop_health, loop_words
from labrun.store import open_run


def test_a_closed_loop_run_is_drawn_even_when_only_some_controllers_have_run(tracked):
    figure = draw(tracked, None)
    assert figure is not None
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_the_loop_s_time_is_told_from_what_it_recorded(tracked):
    with open_run(tracked) as stored:
        view = RunView(stored, experiment_of(stored.experiment_toml, stored.name), None)
        health = loop_health(view, [0, 1, 2])
    assert health is not None
    assert health.steps == 3 * 120
    assert health.missed == 0
    assert 0 <= health.latency_median_s <= health.latency_p99_s < 0.05


def test_show_and_report_tell_the_same_of_it(tracked):
    with open_run(tracked) as stored:
        findings = read_findings(stored)
        text = report_page(findings)
    assert findings.loop is not None
    assert loop_words(findings.loop) in text.replace("\u00a0", " ")


def test_missed_deadlines_are_counted_in_words():
    words = loop_words(LoopHealth(20.0, 200, 3, 0.012, 0.04, 0.011, 0.03, 0.071))
    assert "3 of 200 steps came late or were skipped (1.5 %), by at most 71 ms" in words
    assert "latency 12 ms in the median, 40 ms at 99 %" in words


def test_an_open_loop_run_has_no_loop_to_tell_of(tracked):
    with open_run(tracked) as stored:
        experiment = experiment_of(stored.experiment_toml, stored.name).model_copy(update={"track": None})
        assert loop_health(RunView(stored, experiment, None), [0]) is None


def test_an_orientation_is_drawn_as_the_angle_by_which_it_is_off():
    half = np.deg2rad(10.0) / 2.0
    there = np.array([[-np.cos(half), -np.sin(half), 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    level = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
    assert turned_deg(there, level) == pytest.approx([10.0, np.nan], nan_ok=True)
