"""Turns that no joint made are taken back where they last, left out where they are single, and counted."""

import numpy as np
import pytest
import robot_logs as logs
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.app.logs import LogAnswers, import_log
from labrun.logs import Match, Stream, Wanted, column, correct_turns, find_jumps, statements
from labrun.store import read_recording

TURNS = {"rad": 2 * np.pi, "deg": 360.0, "ticks": 4096.0}


def joint(values, unit="rad", kind="output", time_s=None, episode=None):
    """Return the match of a joint's angle or goal in a unit."""
    time_s = 0.01 * np.arange(len(values)) if time_s is None else time_s
    name, role = ("elbow", "position") if kind == "output" else ("elbow_command", "command")
    angle = column("", name, values)
    stream = Stream("log", time_s, (angle,), episode=episode)
    wanted = Wanted(name, "rad", kind, ("elbow",), (role,))
    return Match(wanted, stream, angle, (2 * np.pi / TURNS[unit], 0.0), unit, "", TURNS[unit])


def corrected(*matches):
    made, findings = correct_turns(matches)
    return [match.column.values for match in made], statements(findings)


@given(
    unit=st.sampled_from(sorted(TURNS)),
    rows=st.lists(st.integers(10, 290), min_size=1, max_size=6, unique=True).filter(
        lambda rows: all(abs(a - b) > 3 for a in rows for b in rows if a != b)
    ),
    seed=st.integers(0, 99),
)
def test_a_counter_that_wraps_is_unwrapped_wherever_it_does(unit, rows, seed):
    rng = np.random.default_rng(seed)
    turn = TURNS[unit]
    smooth = turn * (0.2 * np.sin(0.05 * np.arange(300)) + 1e-4 * rng.standard_normal(300))
    wrapped = smooth.copy()
    for row in rows:
        wrapped[row:] += rng.choice([-1, 1]) * turn
    ((values,), message) = corrected(joint(wrapped, unit))
    offset = np.round((values - smooth) / turn) * turn
    assert np.ptp(offset) == 0
    assert values - offset == pytest.approx(smooth)
    assert f"{len(rows)} times" in message[0] or "once" in message[0]


def test_a_single_sample_a_turn_off_is_left_out_and_told():
    smooth = np.sin(0.02 * np.arange(300))
    glitched = smooth.copy()
    glitched[100] += 2 * np.pi
    glitched[200:202] -= 2 * np.pi
    ((values,), message) = corrected(joint(glitched))
    assert np.flatnonzero(np.isnan(values)).tolist() == [100, 200, 201]
    assert message == ["elbow: 3 single samples lie whole turns off, the first at 1.000 s; left out"]


def test_a_counter_of_16_bits_wraps_at_its_own_length():
    counts = np.round(30000 + 2000 * np.arange(100))
    jumps = find_jumps((counts.astype(np.int64) % 65536).astype(float), (4096.0, 65536.0))
    assert {(jump.turn, jump.turns) for jump in jumps} == {(65536.0, -1)}


def test_a_servo_that_lost_a_turn_at_a_reboot_is_told_with_the_gap():
    time_s = np.append(0.01 * np.arange(200), 10 + 0.01 * np.arange(200))
    still = 0.4 + 1e-3 * np.sin(30 * time_s)
    ((values,), message) = corrected(joint(still + np.where(time_s > 5, 2 * np.pi, 0.0), time_s=time_s))
    assert values == pytest.approx(still)
    assert "after a gap, as of a servo that was switched off" in message[0]


def test_a_turn_lost_at_a_reboot_is_seen_beside_the_goal_where_the_joint_moved_meanwhile():
    time_s = np.append(0.01 * np.arange(200), 10 + 0.01 * np.arange(200))
    goal = np.sin(time_s)
    lost = goal + np.where(time_s > 5, 2 * np.pi, 0.0)
    ((_, values), message) = corrected(joint(goal, kind="input", time_s=time_s), joint(lost, time_s=time_s))
    assert values == pytest.approx(goal)
    assert "+1 whole turns from its goal in 1 part of the log" in message[0]


def test_an_episode_that_begins_a_turn_off_its_goal_is_taken_back():
    phase = 0.02 * np.arange(400)
    episode = np.repeat([0, 1], 200)
    goal = np.sin(phase)
    measured = goal + np.where(episode == 1, 360.0, 0.0)
    ((message, values), text) = corrected(
        joint(goal, "deg", "input", episode=episode), joint(measured, "deg", episode=episode)
    )
    assert values == pytest.approx(goal)
    assert message == pytest.approx(goal)
    assert "+1 whole turns from its goal" in text[0]


def test_a_goal_of_a_whole_turn_that_the_joint_follows_stays():
    goal = np.where(np.arange(600) < 200, 0.0, 2 * np.pi)
    measured = 2 * np.pi * np.clip((np.arange(600) - 200) / 150, 0, 1)
    ((message, values), text) = corrected(joint(goal, kind="input"), joint(measured))
    assert message == pytest.approx(goal)
    assert values == pytest.approx(measured)
    assert not text


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), speed=st.floats(0.1, 60.0))
def test_motion_is_no_jump(seed, speed):
    """A joint that turns up to six turns a second at 100 Hz, and a noisy one, keep every sample."""
    rng = np.random.default_rng(seed)
    time_s = 0.01 * np.arange(400)
    angle = speed * time_s + 0.05 * np.cumsum(rng.standard_normal(400))
    ((values,), message) = corrected(joint(angle))
    assert np.array_equal(values, angle)
    assert not message


def test_ticks_with_a_stated_zero_are_counted_from_it(tmp_path):
    arm = tmp_path / "arm.xml"
    arm.write_text(logs.ARM)
    time_s, goals, angles = logs.motion()
    counts = [np.round(angle * 4096 / (2 * np.pi) + [1000, 2048]) for angle in (goals, angles)]
    log = logs.write_csv(tmp_path / "log.csv", time_s, *counts)
    result = import_log(log, arm, tmp_path / "recording", answers=LogAnswers(zeros=["shoulder=1000"]))
    outputs = np.concatenate([trial.outputs for trial in read_recording(result.folder).trials])
    assert outputs.max(axis=0) == pytest.approx(angles.max(axis=0), abs=2e-3)
    assert outputs.min(axis=0) == pytest.approx(angles.min(axis=0), abs=2e-3)
