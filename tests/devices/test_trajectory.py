"""A motion that is no motion cannot be made."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.devices import Trajectory

TIMES = np.array([0.0, 0.5, 1.0])


@given(st.sampled_from([np.nan, np.inf, -np.inf]), st.integers(0, 2), st.integers(0, 1))
def test_an_angle_that_is_not_finite_is_refused_with_its_joint_and_time(value, point, column):
    angles = np.zeros((3, 2))
    angles[point, column] = value
    with pytest.raises(ValueError, match=f"{value} rad for joint {'ab'[column]} at {TIMES[point]:g} s"):
        Trajectory(("a", "b"), TIMES, angles)


@pytest.mark.parametrize("times", [[0.0, np.nan, 1.0], [0.0, 0.5, np.inf]])
def test_a_time_that_is_not_finite_is_refused(times):
    with pytest.raises(ValueError, match="trajectory has a time of"):
        Trajectory(("a",), np.array(times), np.zeros((3, 1)))


@pytest.mark.parametrize("times", [[0.0, 0.5, 0.5], [0.0, 0.5, 0.4]])
def test_times_that_do_not_increase_are_refused(times):
    with pytest.raises(ValueError, match="do not increase"):
        Trajectory(("a",), np.array(times), np.zeros((3, 1)))


def test_a_single_point_is_a_motion():
    assert Trajectory(("a",), np.zeros(1), np.zeros((1, 1))).duration_s == 0.0
