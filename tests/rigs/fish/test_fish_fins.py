"""Loads of fins in water: drag of poses, the tail's step, what a wake carries to the tail, blades by hand."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.rigs.fish.fins import (
    ATTACHMENTS,
    WATER_KG_M3,
    WATERS,
    edge_drag,
    fin_loads,
    motion_at,
    plate_force,
    strut_drag,
)
from labrun_plugins.rigs.fish.scene import FireTank

from labrun.errors import SpecError

UNIT = (
    st.tuples(*3 * [st.floats(-1, 1)])
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: tuple(np.array(v) / np.linalg.norm(v)))
)
SPEED = st.tuples(*3 * [st.floats(-1, 1)])


def _loads(joints_deg, speed_m_s, step_s, wake=None, **kinds):
    """Loads of joint angles (n, 5) on a fish that goes ahead at one speed, from fins at rest in their first angles."""
    joints = np.radians(joints_deg)
    going = np.zeros((len(joints), 3))
    going[:, 0] = speed_m_s
    wake = np.zeros((WATERS, 3)) if wake is None else wake
    return fin_loads(joints, going, step_s, motion_at(joints[0]), wake, **kinds)


def _beat(step_s, *, pectoral_deg=0.0, tail_deg=60.0, cycles=7, frequency_hz=1.4):
    time_s = np.arange(1, round(cycles / frequency_hz / step_s) + 1) * step_s
    sine = np.sin(2 * np.pi * frequency_hz * time_s)
    joints = np.zeros((len(time_s), 5))
    joints[:, [0, 1, 2, 3]] = pectoral_deg * sine[:, None]
    joints[:, 4] = tail_deg * sine
    return joints


def _thrust(step_s, speed_m_s, **beat):
    loads = _loads(_beat(step_s, **beat), speed_m_s, step_s)
    return loads[len(loads) // 7 :, 0].mean()


@given(u=SPEED, n=UNIT, s=UNIT)
def test_every_force_of_water_takes_energy_from_what_moves_through_it(u, n, s):
    plate = plate_force(*u, *n, 0.01) * np.array(n)
    for force in (plate, edge_drag(*u, *n, 0.01, 0.07), strut_drag(*u, *s, 0.01, 1.1)):
        assert np.dot(force, u) <= 1e-12


@given(u=SPEED, n=UNIT)
def test_edge_drag_lies_in_the_plate_and_struts_feel_nothing_along_themselves(u, n):
    assert np.dot(edge_drag(*u, *n, 0.01, 0.07), n) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(strut_drag(*n, *n, 0.01, 1.1), 0.0, atol=1e-9)


def test_a_strut_across_the_flow_has_the_drag_of_a_cylinder():
    force = strut_drag(0.4, 0.0, 0.0, 0.0, 1.0, 0.0, 0.002, 1.1)
    np.testing.assert_allclose(force, [-0.5 * WATER_KG_M3 * 1.1 * 0.002 * 0.16, 0.0, 0.0], rtol=1e-12)


@pytest.mark.parametrize("speed_m_s", [0.0, 0.1, 0.2])
def test_thrust_of_the_tail_hardly_depends_on_the_step(speed_m_s):
    coarse, fine = _thrust(0.01, speed_m_s), _thrust(0.00125, speed_m_s)
    assert coarse == pytest.approx(fine, abs=0.016)


def test_the_tail_pushes_the_less_the_faster_the_fish_goes():
    thrusts = [_thrust(0.01, speed) for speed in (0.0, 0.1, 0.2, 0.3)]
    assert all(first > other for first, other in pairwise(thrusts))


def test_the_steady_drag_of_fins_grows_with_the_square_of_speed_where_water_has_no_time_to_rest():
    still = np.zeros((4000, 5))
    slow, fast = (-_loads(still, speed, 0.01)[-1, 0] for speed in (0.5, 1.0))
    assert fast / slow == pytest.approx(4.0, rel=0.06)


def test_the_water_that_fins_leave_behind_reaches_the_tail_of_a_fish_that_swims_and_not_of_one_that_rests():
    reached = {}
    for speed_m_s in (0.0, 0.1):
        wake = np.zeros((WATERS, 3))
        wake[:2, 0] = -0.1
        _loads(np.zeros((300, 5)), speed_m_s, 0.01, wake)
        reached[speed_m_s] = wake[3, 0]
    assert reached[0.0] == 0.0
    assert reached[0.1] < -0.003


def test_a_wake_that_flows_back_takes_thrust_from_the_tail():
    beat = _beat(0.01, cycles=2)
    wake = np.zeros((WATERS, 3))
    wake[2, 0] = -0.1
    in_wake, in_still = _loads(beat, 0.1, 0.01, wake), _loads(beat, 0.1, 0.01)
    assert in_wake[:, 0].mean() < in_still[:, 0].mean() - 0.005


def test_without_a_tail_there_is_no_load_of_a_tail():
    beat = _beat(0.01, cycles=2)
    quiet = beat * [1, 1, 1, 1, 0]
    np.testing.assert_array_equal(
        _loads(beat, 0.0, 0.01, caudal=False), _loads(quiet, 0.0, 0.01, caudal=False)
    )
    assert np.abs(_loads(beat, 0.0, 0.01) - _loads(quiet, 0.0, 0.01)).max() > 0.1


def test_an_outer_ring_that_follows_at_once_is_a_blade_of_one_piece():
    broad, two = ATTACHMENTS["broad"], ATTACHMENTS["two-body"]
    quick = type(two)(two.inner_m, two.outer_m, outer_lag_s=1e-9)
    beat = _beat(0.01, pectoral_deg=30.0, cycles=2)
    whole = _loads(beat, 0.1, 0.01, attachment=broad)
    np.testing.assert_allclose(_loads(beat, 0.1, 0.01, attachment=quick), whole, atol=1e-9)
    assert np.abs(_loads(beat, 0.1, 0.01, attachment=two) - whole).max() > 0.1


def test_blades_are_changed_by_hand_and_unknown_ones_are_told():
    tank = FireTank({"noise": 0}, np.random.default_rng(0))
    drags = {}
    for kind in ATTACHMENTS:
        tank = FireTank({"noise": 0}, np.random.default_rng(0))
        tank.arrange({"attachment": kind})
        tank.tow(0.0, 5.0, 0.3, 0.0)
        drags[kind] = -tank.observe(["force_x"], np.arange(3.0, 4.0, 0.01)).mean()
    assert drags["slender"] < drags["broad"]
    assert drags["two-body"] == pytest.approx(drags["broad"])
    with pytest.raises(SpecError, match="no attachment 'wide'") as raises:
        tank.arrange({"attachment": "wide"})
    assert "broad, slender, short, two-body" in str(raises.value.hint)
