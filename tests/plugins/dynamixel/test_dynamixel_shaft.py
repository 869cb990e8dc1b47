"""The shaft of an emulated servo."""

import math

import numpy as np
import pytest
from labrun_plugins.dynamixel.emulated_servo import EmulatedShaft


class Scene:
    def __init__(self):
        self.moves = []

    def drive(self, joint, trajectory, start_s):
        self.moves.append((start_s, trajectory))


def test_goals_a_thousand_times_a_second_reach_the_scene_every_few_milliseconds_and_the_last_one_always():
    scene = Scene()
    shaft = EmulatedShaft("joint", 0.0, scene, 0.0)
    for number in range(100):
        now_s = 1e-3 * number
        shaft.go(0.1 * math.sin(10.0 * now_s), 10.0, now_s)
        shaft.tell(now_s)
    assert 20 <= len(scene.moves) <= 30
    due_s = shaft.tell(0.0995)
    shaft.tell(due_s)
    start_s, last = scene.moves[-1]
    assert last.angle_rad[-1, 0] == pytest.approx(0.1 * math.sin(0.99), abs=1e-3)
    assert shaft.tell(due_s + 1.0) == math.inf
    angle, _, _ = shaft.state(start_s + 0.03)  # the scene gets whole counts of the register
    assert np.interp(0.03, last.time_s, last.angle_rad[:, 0]) == pytest.approx(angle, abs=2e-3)


def test_a_halt_is_told_at_once_and_no_goal_comes_after_it():
    scene = Scene()
    shaft = EmulatedShaft("joint", 0.0, scene, 0.0)
    shaft.go(0.5, 10.0, 0.0)
    shaft.go(0.6, 10.0, 0.001)
    shaft.halt(0.002)
    moves = len(scene.moves)
    assert np.ptp(scene.moves[-1][1].angle_rad) == 0.0
    assert shaft.tell(0.1) == math.inf
    assert len(scene.moves) == moves
