"""Limits: the whole plan before the first move, every command and sample while moving."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paddle_lab import experiment_with

from labrun.errors import LimitExceededError, PlanError
from labrun.runner import Planner, smooth_move

ONE = [{"a": 10, "f": 1.0}]
SLEDGE = {
    "rig__devices__sledge": {"plugin": "pond:Sledge", "limits": {"travel_m": [0, 1], "speed_m_s": 0.5}},
    "trial__carriage": {"device": "sledge", "speed_m_s": "v", "from_m": 0.1, "to_m": 0.9},
}


def test_a_force_beyond_its_limit_stops_the_run_naming_device_channel_value_bound_and_time(lab):
    lab = lab(rig__devices__cell__limits={"force_n": 1.0}, trial__on_fault="skip")
    with pytest.raises(LimitExceededError) as caught:
        lab.session.measure([{"a": 50, "f": 1.2}])
    text = str(caught.value)
    assert text.startswith("device cell: force_x ")
    assert re.search(
        r"N is (above the limit of 1|below the limit of -1) N in trial 0, \d+\.\d{3} s after its start", text
    )
    assert lab.stops()[-1].startswith("safe_stop")
    assert lab.folder.outcomes()[0].status == "failed"


def test_limits_are_watched_while_the_bench_settles(lab):
    lab = lab(
        rig__scene={"plugin": "pond:Pond", "echo_n": 50.0, "decay_s": 1e6},
        rig__devices__cell__limits={"force_n": 4.0},
    )
    with pytest.raises(LimitExceededError):
        lab.session.measure([{"a": 5, "f": 0.2}])


def test_a_joint_that_runs_away_is_stopped_by_its_measured_angle(lab):
    lab = lab(rig__devices__tail__runaway_after_s=6.0, rig__devices__cell__limits={"force_n": 1e5})
    with pytest.raises(
        LimitExceededError, match=r"device tail: measured angle of tail 171.9 deg is above the limit of 60"
    ):
        lab.session.measure(ONE)


def test_a_hot_servo_is_not_driven(lab):
    lab = lab(
        rig__devices__tail__temperature_c=72.0,
        rig__devices__tail__limits={"temperature_c": 65.0},
    )
    with pytest.raises(
        LimitExceededError,
        match="device tail: temperature 72 degC is above the limit of 65 degC in trial 0, ",
    ):
        lab.session.measure(ONE)
    assert not any(line.startswith("follow") for line in lab.stops())


def test_the_plan_finds_every_condition_that_leaves_a_limit_before_anything_moves():
    experiment = experiment_with()
    conditions = [{"a": float(a), "f": 1.0} for a in range(10, 90, 5)]
    result = Planner(experiment).plan(conditions)
    assert [item.condition["a"] for item in result.excess] == [65.0, 70.0, 75.0, 80.0, 85.0]
    with pytest.raises(PlanError) as caught:
        result.require_feasible()
    text = str(caught.value)
    assert "5 of 16 conditions leave a limit" in text
    assert "a = 65, f = 1: angle of tail" in text
    assert "is above the limit of 60 deg" in text


def test_the_size_of_an_excess_grows_with_the_distance_from_the_limit():
    experiment = experiment_with()
    sizes = [Planner(experiment).excess_of({"a": a, "f": 0.5})[0].value for a in (61.0, 65.0, 80.0)]
    assert sizes == pytest.approx([61.0, 65.0, 80.0], rel=1e-3)
    assert Planner(experiment).excess_of({"a": 59.9, "f": 0.5}) == []


def test_speed_is_checked_too():
    (excess,) = Planner(experiment_with()).excess_of({"a": 50.0, "f": 3.0})
    assert excess.unit == "deg/s"
    assert excess.bound == 600


def test_a_safe_pose_outside_the_limits_is_found_in_the_plan():
    result = Planner(experiment_with(trial__safe_pose_deg={"tail": 75})).plan(ONE)
    assert "safe pose of tail 75 deg is above the limit of 60 deg" in str(result.excess[0].excess[0])


def test_the_plan_counts_trials_time_disk_and_demand():
    experiment = experiment_with(
        trial__repeats={"min": 2, "max": 5}, trial__reference={"every": 3, "condition": {"a": 15, "f": 1.0}}
    )
    report = (
        Planner(experiment).plan([{"a": 10, "f": 1.0}, {"a": 20, "f": 2.0}, {"a": 30, "f": 1.0}]).report()
    )
    assert report["conditions"] == 3
    assert report["trials"] == 6 + 2
    assert report["trials_at_most"] == 15 + 5
    assert report["rates_hz"] == {"cell": 100.0}
    assert report["joints"]["tail"]["angle_deg"] == pytest.approx([-30, 30], rel=1e-3)
    assert report["joints"]["tail"]["speed_deg_s"] == pytest.approx(20 * 2 * np.pi * 2, rel=0.01)
    assert report["settle_s_assumed"] == 2.0
    # 3 cycles, 2 s of settling, 0.5 s of tare, and the moves.
    assert 8 * 4.0 < report["time_s"] < 8 * 6.5
    assert report["disk_bytes"] > 8 * 300 * 8 * 4


def test_the_disk_asked_for_covers_the_trial_files_and_the_packed_run_beside_them(lab):
    lab = lab()
    conditions = [{"a": 10, "f": 1.0}, {"a": 20, "f": 1.0}]
    plan = Planner(lab.experiment, lab.rig).plan(conditions)
    lab.session.measure(conditions)
    trials = sum(path.stat().st_size for path in lab.folder.path.glob("trials/*.h5"))
    packed = lab.folder.pack().stat().st_size
    assert trials + packed <= plan.disk_bytes <= 4 * (trials + packed)
    assert packed <= plan.disk_kept_bytes <= plan.disk_bytes


def test_the_estimated_time_is_close_to_what_the_run_takes(lab):
    lab = lab()
    conditions = [{"a": 10, "f": 1.0}, {"a": 20, "f": 2.0}]
    estimate = Planner(lab.experiment, lab.rig).plan(conditions)
    start_s = lab.clock.now()
    lab.session.measure(conditions)
    assert lab.clock.now() - start_s == pytest.approx(estimate.time_s, rel=0.25)


def test_an_empty_plan_is_refused():
    with pytest.raises(PlanError, match="no condition"):
        Planner(experiment_with()).plan([])


def test_as_many_whole_cycles_as_the_travel_allows_are_recorded(lab):
    lab = lab(**SLEDGE, trial__cycles="fit", trial__discard_cycles=1)
    (result,) = lab.session.measure([{"a": 10, "f": 1.0, "v": 0.15}])
    # 0.8 m at 0.15 m/s is 5.33 s: five cycles of 1 s.
    assert result.outcomes[0].duration_s == 5.0
    _, goals, speeds = zip(*lab.rig.devices["sledge"].travels, strict=True)
    assert goals == (0.1, 0.9, 0.1, 0.9)
    assert speeds == (0.1, 0.15, 0.1, 0.15)
    assert lab.rig.devices["sledge"].position_m() > 0.8


def test_a_travel_that_ends_before_the_recording_is_an_excess():
    experiment = experiment_with(**SLEDGE, trial__cycles=10)
    (excess,) = Planner(experiment).excess_of({"a": 10, "f": 1.0, "v": 0.2})
    assert "against the carriage's travel" in str(excess)
    assert Planner(experiment).excess_of({"a": 10, "f": 1.0, "v": 0.08}) == []


def test_a_carriage_faster_than_its_limit_is_an_excess():
    experiment = experiment_with(**SLEDGE, trial__cycles=1, trial__discard_cycles=0)
    excesses = Planner(experiment).excess_of({"a": 10, "f": 5.0, "v": 0.6})
    assert any(str(excess) == "speed 0.6 m/s is above the limit of 0.5 m/s" for excess in excesses)


def test_cycles_that_fit_need_a_carriage_that_moves():
    with pytest.raises(PlanError, match="stands still"):
        Planner(experiment_with(**SLEDGE, trial__cycles="fit")).plan([{"a": 10, "f": 1.0, "v": 0.0}])


@given(
    st.dictionaries(st.sampled_from("abcd"), st.floats(-3, 3), min_size=1),
    st.dictionaries(st.sampled_from("abcd"), st.floats(-3, 3), min_size=4),
    st.floats(0.05, 10),
)
def test_a_move_is_smooth_within_its_speed_and_between_its_ends(goal, start, speed):
    move = smooth_move(start, goal, speed)
    if move is None:
        assert all(abs(start[joint] - angle) < 1e-6 for joint, angle in goal.items())
        return
    assert np.allclose(move.angle_rad[0], [start[j] for j in move.joints])
    assert np.allclose(move.angle_rad[-1], [goal[j] for j in move.joints])
    assert np.all(move.peak_speed_rad_s() <= speed * (1 + 1e-6))
    for joint, column in zip(move.joints, move.angle_rad.T, strict=True):
        low, high = sorted((start[joint], goal[joint]))
        assert np.all((column >= low - 1e-12) & (column <= high + 1e-12))
