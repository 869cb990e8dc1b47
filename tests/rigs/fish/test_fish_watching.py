"""What somebody with a watch reads of the free fish."""

import numpy as np
import pytest
from labrun_plugins.rigs.fish.free_scene import FireFree, Watch

from labrun.devices import Trajectory
from labrun.errors import ExperimentError


def watched(heading, x=None, beating=None, seconds=40.0, distance_m=1.0):
    time_s = np.linspace(0.0, seconds, 4001)
    course = np.column_stack(
        [x(time_s) if x else np.zeros_like(time_s), np.zeros_like(time_s), heading(time_s)]
    )
    watch = Watch(distance_m)
    watch.look(time_s, course, np.ones(len(time_s)) if beating is None else beating(time_s))
    return watch


def test_a_steady_turn_is_timed_in_its_full_turns():
    watch = watched(lambda t: -np.radians(30.0) * t)
    assert watch.read("seconds_per_turn", 0.0) == pytest.approx(12.0, abs=0.05)


def test_the_time_to_get_up_to_speed_does_not_count_nor_what_comes_after_the_beat():
    def heading(t):
        return np.radians(30.0) * np.clip(t - 5.0, 0.0, 30.0)

    watch = watched(heading, beating=lambda t: t <= 35.0)
    assert watch.read("seconds_per_turn", 0.0) == pytest.approx(12.0, abs=0.05)


def test_all_turns_after_the_first_are_timed_together():
    watch = watched(lambda t: np.interp(t, [0, 16, 26, 40], np.radians([0, 360, 720, 1440])))
    assert watch.read("seconds_per_turn", 0.0) == pytest.approx(8.0, abs=0.05)  # 24 s for three


def test_less_than_a_turn_is_timed_over_what_there_is():
    watch = watched(lambda t: np.radians(4.5) * t)
    assert watch.read("seconds_per_turn", 0.0) == pytest.approx(80.0, rel=1e-3)


@pytest.mark.parametrize("distance_m", [0.5, 1.0, 3.0])
def test_the_measured_distance_is_timed_after_the_fish_is_up_to_speed(distance_m):
    watch = watched(lambda t: 0.0 * t, x=lambda t: 0.25 * np.clip(t - 10.0, 0.0, None), distance_m=distance_m)
    assert watch.read("seconds_over_distance", 0.0) == pytest.approx(distance_m / 0.25, abs=0.05)


def test_a_fish_that_stays_does_not_swim():
    watch = watched(lambda t: 0.0 * t, x=lambda t: 0.25 * t)
    assert watch.read("swims", 0.0) == "yes"
    assert watched(lambda t: 0.0 * t, x=lambda t: 0.001 * t).read("swims", 0.0) == "no"


def test_what_nobody_can_read_and_fins_at_rest_are_told():
    with pytest.raises(ExperimentError, match="nobody can read 'colour'"):
        watched(lambda t: t).read("colour", 0.0)
    with pytest.raises(ExperimentError, match="no fin was seen to move"):
        watched(lambda t: t, beating=lambda t: 0.0 * t).read("seconds_per_turn", 0.0)


def test_the_scene_answers_from_the_trial_that_was_just_run():
    pool = FireFree({"noise": 0, "caudal": "off"}, np.random.default_rng(1))
    pool.observe(["heading"], np.array([0.0]))
    pool.arrange({})
    time_s = np.linspace(0.0, 40.0, 4001)
    turn = 2 * np.pi * 1.49 * time_s
    first = np.radians(-14.1 + 44.8 * np.sin(turn))
    second = np.radians(16.6 + 43.3 * np.sin(turn - np.radians(80.7)))
    for joint, angle in (("right_1", first), ("right_2", second), ("left_1", -first), ("left_2", -second)):
        pool.drive(joint, Trajectory((joint,), time_s, angle[:, None]), 0.5)
    turning = pool.observe(["turning"], np.linspace(30.0, 40.0, 1001)).mean()
    assert 360.0 / pool.answer("seconds_per_turn") == pytest.approx(abs(np.degrees(turning)), rel=0.05)
