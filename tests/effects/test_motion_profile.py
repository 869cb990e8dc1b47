"""A goal that a drive runs to with a trapezoid of speed, against closed forms and limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import named

from labrun.models import parse_model, simulate

THROUGH = parse_model('name = "drive"\nstates = []\ninputs = ["goal"]\n[outputs]\ny = "goal"\n', "drive.toml")
TIME = np.arange(0, 4, 0.01)


def _course(goal, rate, ramp_time, between="hold", substeps=1, time_s=TIME):
    model = THROUGH.with_between({"goal": between})
    profile = named("motion-profile", "input", "goal", rate=rate, ramp_time=ramp_time)
    goals = np.asarray(goal, dtype=float)[:, None]
    return simulate(model, time_s, goals, effects=[profile], substeps=substeps).outputs[:, 0]


def _step(size, at_s=0.5):
    return np.where(at_s - 1e-9 <= TIME, size, 0.0)


@settings(max_examples=40, deadline=None)
@given(size=st.floats(0.05, 3.0), rate=st.floats(0.5, 4.0), ramp_time=st.floats(0.02, 1.0), up=st.booleans())
def test_a_step_becomes_a_trapezoid_or_a_triangle_of_speed(size, rate, ramp_time, up):
    acceleration = rate / ramp_time
    peak = min(rate, np.sqrt(size * acceleration))
    rising, whole = peak / acceleration, size / peak + peak / acceleration
    since = np.clip(TIME - 0.5, 0.0, whole)
    exact = np.where(
        since < rising, acceleration * since**2 / 2,
        np.where(
            since < whole - rising, peak * (since - rising / 2), size - acceleration * (whole - since) ** 2 / 2
        ),
    )  # fmt: skip
    sign = 1.0 if up else -1.0
    assert _course(sign * _step(size), rate, ramp_time) == pytest.approx(sign * exact, abs=1e-6 * size)


@settings(max_examples=25, deadline=None)
@given(
    goals=st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=8),
    rate=st.floats(0.5, 4.0),
    ramp_time=st.floats(0.05, 0.5),
)
def test_whatever_the_goals_speed_and_acceleration_stay_within_their_limits(goals, rate, ramp_time):
    held = np.repeat(goals, -(-len(TIME) // len(goals)))[: len(TIME)]
    course = _course(held, rate, ramp_time)
    speed = np.diff(course) / 0.01
    assert np.max(np.abs(speed)) <= rate * (1 + 1e-6)
    assert np.max(np.abs(np.diff(speed))) / 0.01 <= rate / ramp_time * (1 + 1e-6) + 1e-6


@settings(max_examples=15, deadline=None)
@given(goals=st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=6), substeps=st.sampled_from([2, 5]))
def test_shorter_steps_of_the_integrator_give_the_same_course(goals, substeps):
    held = np.repeat(goals, -(-len(TIME) // len(goals)))[: len(TIME)]
    assert _course(held, 1.5, 0.3, substeps=substeps) == pytest.approx(_course(held, 1.5, 0.3), abs=1e-9)


def test_it_rests_at_its_goal_and_a_goal_it_is_given_on_the_way_is_run_to_at_once():
    course = _course(_step(1.0) - 2.0 * (TIME >= 1.0 - 1e-9), 1.5, 0.4)
    assert course[-1] == pytest.approx(-1.0, abs=1e-12)
    assert np.max(course) < 1.0


def test_without_a_ramp_it_is_a_rate_limit():
    limited = named("rate-limit", "input", "goal", rate=1.5)
    model = THROUGH.with_between({"goal": "hold"})
    goal = _step(1.0) - 1.7 * (TIME >= 2.0 - 1e-9)
    exact = simulate(model, TIME, goal[:, None], effects=[limited], substeps=1).outputs[:, 0]
    assert _course(goal, 1.5, 1e-6) == pytest.approx(exact, abs=1e-5)


def test_a_mass_is_pushed_by_the_mean_of_each_step():
    """What the integrator sees of a step adds up to the area under the trapezoid, however few the steps are."""
    summed = parse_model(
        'name = "sum"\nstates = ["x"]\ninputs = ["goal"]\n[equations]\nx = "goal"\n[outputs]\ny = "x"\n'
        "[initial]\nx = 0.0",
        "sum.toml",
    ).with_between({"goal": "hold"})
    profile = named("motion-profile", "input", "goal", rate=2.0, ramp_time=0.35)
    coarse = np.arange(0, 4, 0.05)
    goal = np.where(coarse >= 0.5, 1.0, 0.0)[:, None]
    result = simulate(summed, coarse, goal, effects=[profile], substeps=1, initial_state=[0.0]).outputs[:, 0]
    # the trapezoid is symmetric about its middle
    middle = 0.5 + (1.0 / 2.0 + 0.35) / 2
    assert result[-1] == pytest.approx(coarse[-1] - middle, abs=1e-9)
