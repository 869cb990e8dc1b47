"""Feedbacks: from samples to the number a loop compares."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.control.feedbacks import mean_over
from labrun.control.history import History
from labrun.control.making import make_feedback
from labrun.devices import Samples
from labrun.errors import SpecError
from labrun.toml import PluginTable

UNITS = {"wrench.x": "N m", "wrench.y": "N m", "imu.roll": "rad"}


def feedback(plugin, **settings):
    return make_feedback("force", PluginTable(plugin=plugin, **settings), UNITS)


def history(time_s, *columns, tare=None, start_s=0.0, keep_s=10.0, block=None):
    """Feed a history with blocks of `block` samples."""
    channels = {"wrench.x": 0, "wrench.y": 1}
    result = History(channels, tare or {}, start_s, keep_s)
    values = np.column_stack([columns[0], columns[-1]])
    size = block or len(time_s)
    for first in range(0, len(time_s), size):
        part = slice(first, first + size)
        result.take({"wrench": Samples(time_s[part], time_s[part], values[part])})
    return result


def test_the_cycle_average_cancels_what_repeats_whatever_the_phase():
    period_s = 1 / 1.4
    for end_s in np.linspace(3.0, 3.0 + period_s, 17):
        time_s = np.arange(0, end_s, 0.001)
        force = 0.25 + 3.0 * np.sin(2 * np.pi * 1.4 * time_s) + 1.0 * np.sin(4 * np.pi * 1.4 * time_s)
        result = feedback("cycle-average", channel="wrench.x")(history(time_s, force), period_s)
        assert result == pytest.approx(0.25, abs=1e-4)


def test_before_one_cycle_is_over_the_average_is_of_what_there_is():
    time_s = np.linspace(0.0, 0.2, 21)
    result = feedback("cycle-average", channel="wrench.x")(history(time_s, time_s), 1.0)
    assert result == pytest.approx(0.1)
    average = feedback("cycle-average", channel="wrench.x")(history(np.array([0.1]), np.array([7.0])), 1.0)
    assert average == 7.0


@given(st.lists(st.floats(0.001, 0.3), min_size=2, max_size=60), st.floats(0.05, 5.0), st.integers(0, 10**6))
def test_the_mean_over_a_window_is_the_integral_of_the_line_through_the_samples(gaps, window_s, seed):
    time_s = np.cumsum(gaps)
    values = np.random.default_rng(seed).standard_normal(len(time_s))
    start_s = max(time_s[0], time_s[-1] - window_s)
    grid = np.union1d(np.linspace(start_s, time_s[-1], 50), time_s[time_s >= start_s])
    line = np.interp(grid, time_s, values)
    expected = np.trapezoid(line, grid) / (grid[-1] - grid[0])
    assert mean_over(time_s, values, window_s) == pytest.approx(expected, abs=1e-9)


def test_lost_samples_do_not_shift_the_mean():
    time_s = np.arange(0.0, 1.0, 0.01)
    kept = np.ones(len(time_s), dtype=bool)
    kept[40:60] = False
    result = feedback("moving-average", channel="wrench.x", window_s=0.9)(
        history(time_s[kept], time_s[kept]), None
    )
    assert result == pytest.approx(0.99 - 0.45)


def test_scale_length_tare_and_unit_are_those_of_objectives():
    time_s = np.arange(0.0, 1.0, 0.01)
    torque = np.full(len(time_s), -0.2)
    tared = history(time_s, torque, tare={"wrench.x": -0.1})
    force = feedback("latest", channel="wrench.x", divide_by_m=0.4, scale=-1.0)
    assert force.unit == "N"
    assert force(tared, None) == pytest.approx(0.25)


def test_an_angle_can_be_given_in_degrees_and_a_torque_cannot():
    assert feedback("latest", channel="imu.roll", unit="deg").unit == "deg"
    result = History({"imu.roll": 0}, {}, 0.0, 1.0)
    result.take({"imu": Samples(np.zeros(1), np.zeros(1), np.array([[np.pi / 6]]))})
    assert feedback("latest", channel="imu.roll", unit="deg")(result, None) == pytest.approx(30.0)
    with pytest.raises(SpecError, match="N m"):
        feedback("latest", channel="wrench.x", unit="deg")


def test_the_magnitude_is_that_of_the_averaged_vector():
    period_s = 0.5
    time_s = np.arange(0.0, 2.0, 0.001)
    swing = 10 * np.sin(2 * np.pi * time_s / period_s)
    both = history(time_s, 3.0 + swing, 4.0 - swing)
    result = feedback("cycle-average", channel="wrench.x", side_channel="wrench.y")(both, period_s)
    assert result == pytest.approx(5.0, abs=1e-3)


def test_a_long_recording_in_small_blocks_gives_what_one_block_gives():
    time_s = np.arange(0.0, 100.0, 0.01)
    force = np.sin(time_s)
    whole = history(time_s, force, block=len(time_s))
    parts = history(time_s, force, block=7, keep_s=2.0)
    average = feedback("moving-average", channel="wrench.x", window_s=2.0)
    assert average(parts, None) == pytest.approx(average(whole, None), abs=1e-12)
    assert len(parts.recent("wrench.x")[0]) <= 4096


def test_samples_from_before_the_recording_count_only_until_its_first():
    time_s = np.arange(9.9, 10.3, 0.01)
    force = np.where(time_s < 10.0 - 1e-9, 100.0, 1.0)
    started = history(time_s, force, start_s=10.0, block=1)
    assert feedback("moving-average", channel="wrench.x", window_s=5.0)(started, None) == pytest.approx(1.0)


def test_a_device_with_a_clock_of_its_own_is_placed_on_the_runs_clock():
    result = History({"wrench.x": 0, "wrench.y": 1}, {}, 50.0, 1.0)
    made_s = np.arange(0.0, 1.0, 0.01) + 50.0
    late_s = made_s + 0.004 + np.random.default_rng(1).exponential(0.01, 100)
    for number in range(0, 100, 10):
        part = slice(number, number + 10)
        values = np.zeros((10, 2))
        result.take({"wrench": Samples(made_s[part] - 1234.0, late_s[part], values)})
    times = result.recent("wrench.x")[0]
    assert np.all(np.diff(times) >= 0)
    assert times[-1] == pytest.approx(0.99 + 0.004, abs=2e-3)
    assert result.newest_s(["wrench.x"]) == times[-1]
