import itertools

import numpy as np
import pytest
from equations import FOLLOWER
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import ModelError
from labrun.models import parse_model, simulate
from labrun.models.layout import drive

MODEL = parse_model(FOLLOWER, "follower.toml")
TAU = 0.5


def _response(between, time_s, u, substeps):
    model = MODEL.with_between({"u": between})
    return simulate(model, time_s, u[:, None], initial_state=[0.0], substeps=substeps).outputs[:, 0]


def test_a_held_input_jumps_at_its_samples():
    time_s = np.arange(0, 3, 0.05)
    u = np.random.default_rng(1).normal(size=len(time_s))
    exact = [0.0]
    for value in u[:-1]:
        exact.append(value + (exact[-1] - value) * np.exp(-0.05 / TAU))
    assert _response("hold", time_s, u, 4) == pytest.approx(exact, abs=2e-8)


def test_a_linear_input_goes_straight_between_its_samples():
    time_s = np.arange(0, 3, 0.05)
    u = np.random.default_rng(1).normal(size=len(time_s))
    exact = [0.0]
    for a, b in itertools.pairwise(u):
        slope = (b - a) / 0.05
        exact.append(b - slope * TAU + (exact[-1] - a + slope * TAU) * np.exp(-0.05 / TAU))
    assert _response("linear", time_s, u, 4) == pytest.approx(exact, abs=2e-8)


def test_a_band_limited_input_is_the_signal_that_was_sampled():
    time_s = np.arange(0, 20, 0.05)  # Nyquist frequency 10 Hz
    rng = np.random.default_rng(2)
    lines = [(frequency, rng.uniform(0, 2 * np.pi)) for frequency in (0.7, 3.1, 6.5, 8.5)]
    u = sum(np.sin(2 * np.pi * f * time_s + phase) for f, phase in lines)
    laid = drive(time_s, u[:, None], ["band-limited"], 4)
    middle = (laid.time_s[:-1, None] + np.arange(4) * 0.0125 + 0.00625).ravel()
    truth = sum(np.sin(2 * np.pi * f * middle + phase) for f, phase in lines)
    inside = (middle > 4) & (middle < 16)
    assert laid.u[inside, 1, 0] == pytest.approx(truth[inside], abs=1e-3)
    # towards the ends the signal is a continuation, yet no further off than one that is straight between samples
    straight = np.interp(middle, time_s, u)
    assert np.std((laid.u[:, 1, 0] - truth)[~inside]) < np.std((straight - truth)[~inside])
    assert laid.u[::4, 0, 0] == pytest.approx(u[:-1], abs=1e-9)


@given(st.floats(-100, 100), st.integers(2, 40))
@settings(max_examples=30, deadline=None)
def test_a_constant_stays_constant_however_it_runs(value, count):
    for between in ("linear", "hold", "band-limited"):
        laid = drive(np.arange(count) * 0.1, np.full((count, 1), value), [between], 3)
        assert laid.u == pytest.approx(np.full_like(laid.u, value), rel=1e-12, abs=1e-12)


def test_rounded_time_stamps_count_as_even():
    time_s = np.round(np.arange(200) / 610.35, 6)
    assert drive(time_s, np.ones((200, 1)), ["band-limited"], 2).u.shape == (398, 3, 1)


def test_an_uneven_band_limited_input_is_an_error_that_says_where():
    time_s = np.concatenate([np.arange(50) * 0.1, 5.3 + np.arange(50) * 0.1])
    with pytest.raises(ModelError, match=r"at t = 4\.9 s differs by"):
        drive(time_s, np.ones((100, 1)), ["band-limited"], 1)


def test_one_sample_is_a_simulation_of_one_moment():
    assert _response("hold", np.array([2.0]), np.array([1.0]), 1).tolist() == [0.0]
