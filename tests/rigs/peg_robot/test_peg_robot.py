"""The peg robot: which thickness walks, and why."""

import json
import math

import numpy as np
import pytest
from labrun_plugins.rigs.beam.tape_spring_fit import TapeSpring
from labrun_plugins.rigs.peg_robot.scene import PegRobot, beam_torques

from labrun.devices import Trajectory
from labrun.errors import SpecError

PITCH_M = 0.04


def robot(seed=0, **keys):
    return PegRobot({"noise": 0, **keys}, np.random.default_rng(seed))


def swings(cycles=6, amplitude_deg=40.0, frequency_hz=0.25):
    time_s = np.arange(0.0, cycles / frequency_hz, 0.01)
    angle = math.radians(amplitude_deg) * np.sin(2 * math.pi * frequency_hz * time_s)
    return Trajectory(("arm",), time_s, angle[:, None], 1 / frequency_hz)


def walked(made, cycles=6, signal="position"):
    """Return where the body is over the cycles, one row a cycle."""
    made.observe((signal,), np.zeros(1))
    made.drive("arm", swings(cycles), 1.0)
    time_s = 1.0 + 4.0 * np.arange(cycles)[:, None] + np.linspace(0, 4, 400, endpoint=False)
    return made.observe((signal,), time_s.ravel())[:, 0].reshape(cycles, -1)


def test_the_limits_are_those_of_the_tape_spring_and_only_with_the_chord_one_friction_separates_them():
    limits = [TapeSpring(mil * 25.4e-6, width="chord") for mil in (3, 5, 10)]
    assert [1e3 * limit.equal_limit_n_m for limit in limits] == pytest.approx([0.37, 1.7, 13.9], rel=0.03)
    assert [1e3 * limit.opposite_limit_n_m for limit in limits] == pytest.approx([5.2, 14.6, 59.7], rel=0.01)
    thin, _, thick = (TapeSpring(mil * 25.4e-6, width="arc") for mil in (3, 5, 10))
    assert thin.opposite_limit_n_m > thick.equal_limit_n_m


@pytest.mark.parametrize(("mil", "least", "most"), [(3, 0.0, 0.0), (5, 0.8, 2.1), (10, 0.0, 0.01)])
def test_3_mil_stands_5_mil_walks_and_10_mil_comes_back(mil, least, most):
    position = walked(robot(thickness_mil=mil))
    advance = (position[-1, 0] - position[2, 0]) / 3 / PITCH_M
    assert least <= advance + 1e-12
    assert advance <= most + 1e-12


def test_3_mil_does_not_move_at_all_and_10_mil_goes_to_and_fro():
    assert np.ptp(walked(robot(thickness_mil=3))) == 0.0
    assert np.ptp(walked(robot(thickness_mil=10))[2:], axis=1).min() > 0.2 * PITCH_M


def test_with_more_friction_than_5_mil_can_push_it_stands_and_with_less_than_it_buckles_at_it_comes_back():
    assert np.ptp(walked(robot(friction_mn_m=16.0))) == 0.0
    slippery = walked(robot(friction_mn_m=1.0))
    assert abs(slippery[-1, 0] - slippery[-2, 0]) < 0.2 * PITCH_M


def test_an_arm_that_clears_a_peg_only_beyond_its_own_swing_never_passes_one():
    position = walked(robot(passes_deg=45.0))
    assert abs(position[-1, 0] - position[2, 0]) < 0.01 * PITCH_M


def test_the_torque_of_a_bent_beam_is_that_of_its_curvature():
    torques = beam_torques(5.0, "chord", 0.0254, 0.5)
    assert torques.max() == pytest.approx(14.585e-3, rel=1e-3)
    bends = np.linspace(0, 0.5, len(torques))
    assert np.interp(0.0254, bends, torques) == pytest.approx(11.14e-3, rel=1e-2)


def test_other_sheets_are_put_in_and_impossible_ones_refused():
    made = robot()
    made.arrange({"thickness_mil": 10})
    assert made.truth()["parameters"]["equal_limit"] == pytest.approx(13.9e-3, rel=0.01)
    with pytest.raises(SpecError, match="50"):
        made.arrange({"thickness_mil": 50})


def test_a_stored_robot_goes_on_to_the_last_bit():
    hide = [{"effect": "delay", "site": "arm"}, {"effect": "drift", "site": "position"}]
    made = robot(seed=2, noise=1, hide=hide)
    walked(made, 1)
    again = robot(seed=7, noise=1, hide=hide)
    again.restore(json.loads(json.dumps(made.snapshot())))
    later = np.arange(5.0, 9.0, 0.05)
    made.drive("arm", swings(1), 5.0)
    again.drive("arm", swings(1), 5.0)
    assert np.array_equal(made.observe(("position",), later), again.observe(("position",), later))
    assert made.truth() == again.truth()
