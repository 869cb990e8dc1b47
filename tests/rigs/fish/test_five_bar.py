"""The pectoral mechanism: its loop closes, its arcs stay, it is symmetric; and its plates obey the plate equations."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from labrun_plugins.rigs.fish.fins import WATER_KG_M3, plate_force
from labrun_plugins.rigs.fish.five_bar import ARC_RAD, greatest_difference, hinge_axes, reached
from scipy.spatial.transform import Rotation

ANGLE = st.floats(-1.7, 1.7)


def _closure_residual(axes):
    """Walk around the loop by passive angles: rotations about each hinge, then along each arc, must give identity."""
    turn = Rotation.identity()
    for i in range(5):
        before, here, after = axes[i - 1], axes[i], axes[(i + 1) % 5]
        into = np.cross(before, here)
        out = np.cross(here, after)
        fold = math.atan2(here @ np.cross(into, out), into @ out)
        turn = turn * Rotation.from_rotvec([0, 0, fold]) * Rotation.from_rotvec([ARC_RAD, 0, 0])
    return np.abs(turn.as_matrix() - np.eye(3)).max()


@settings(deadline=None)
@given(first=ANGLE, second=ANGLE)
def test_the_loop_closes_and_all_arcs_stay_72_degrees(first, second):
    axes = hinge_axes(*reached(first, second))
    arcs = np.arctan2(
        np.linalg.norm(np.cross(axes, np.roll(axes, -1, 0)), axis=1),
        np.sum(axes * np.roll(axes, -1, 0), axis=1),
    )
    np.testing.assert_allclose(arcs, ARC_RAD, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-12)
    assert _closure_residual(axes) < 1e-9


@settings(deadline=None)
@given(first=ANGLE, second=ANGLE)
def test_the_servo_links_stand_where_the_servos_turned_them(first, second):
    first, second = reached(first, second)
    axes = hinge_axes(first, second)
    flat = hinge_axes(0.0, 0.0)
    for servo, link, angle, sense in [(0, 1, first, -1), (4, 3, second, 1)]:
        turned = Rotation.from_rotvec(sense * angle * flat[servo]).apply(flat[link])
        np.testing.assert_allclose(axes[link], turned, atol=1e-12)


@settings(deadline=None)
@given(first=ANGLE, second=ANGLE)
def test_swapping_the_servos_mirrors_the_mechanism_and_negating_them_folds_it_to_the_other_side(
    first, second
):
    first, second = reached(first, second)
    axes = hinge_axes(first, second)
    np.testing.assert_allclose(hinge_axes(second, first), axes[::-1] * [1, -1, 1], atol=1e-9)
    assume(abs(first + second) > 1e-9)
    np.testing.assert_allclose(hinge_axes(-first, -second), axes * [1, 1, -1], atol=1e-9)


def test_the_neutral_state_is_flat():
    axes = hinge_axes(0.0, 0.0)
    np.testing.assert_allclose(axes[:, 2], 0.0, atol=1e-15)
    np.testing.assert_allclose(axes.sum(axis=0), 0.0, atol=1e-12)  # a regular pentagon of directions


def test_the_sheet_passes_smoothly_through_flat():
    angles = np.linspace(-0.2, 0.2, 401)
    meeting = np.array([hinge_axes(angle, angle)[2, 2] for angle in angles])
    steps = np.diff(meeting)
    assert steps.min() > 0
    assert np.ptp(steps) < 0.05 * steps.mean()


@settings(deadline=None)
@given(total=st.floats(-3.0, 3.0), excess=st.floats(0.001, 0.5))
def test_beyond_the_greatest_difference_no_loop_closes_and_servos_yield_before_it(total, excess):
    most = greatest_difference(total)
    assume(most + excess < 3.0)
    beyond = most + excess
    first, second = reached((total + beyond) / 2, (total - beyond) / 2)
    assert abs(first - second) <= 0.85 * most + 1e-12
    with pytest.raises(ValueError, match="no loop closes"):
        hinge_axes((total + beyond) / 2, (total - beyond) / 2)


@settings(deadline=None)
@given(first=ANGLE, second=ANGLE)
def test_saturation_keeps_the_sum_never_widens_the_difference_and_leaves_angles_alone_well_inside(
    first, second
):
    here = reached(first, second)
    total, difference = first + second, first - second
    assert sum(here) == pytest.approx(total, abs=1e-12)
    assert 0.0 <= (here[0] - here[1]) * np.sign(difference) <= abs(difference)
    if abs(total) > 1.0 and abs(difference) < 0.3 * greatest_difference(total):
        assert here[0] - here[1] == pytest.approx(difference, rel=0.02)


@pytest.mark.parametrize("lead_rad", [0.1, 0.5, 1.0])
def test_fin_axes_move_without_kink_or_jump_through_flat_however_far_the_servos_are_apart(lead_rad):
    step = 1e-3
    sums = np.arange(-1.5, 1.5, step)
    axes = np.array([hinge_axes(*reached((total + lead_rad) / 2, (total - lead_rad) / 2)) for total in sums])
    rate = np.diff(axes, axis=0) / step
    assert np.abs(rate).max() < 4.0  # rad per rad of the servos' sum
    assert np.abs(np.diff(rate, axis=0)).max() < 0.1


@settings(deadline=None)
@given(speed=st.floats(0.01, 2.0), attack=st.floats(-math.pi / 2, math.pi / 2), area=st.floats(1e-4, 0.1))
def test_plate_force_has_the_drag_and_lift_of_the_source(speed, attack, area):
    # The plate moves along x; its normal stands at 90 degrees minus the angle of attack from its motion.
    n_x, n_y = math.sin(attack), math.cos(attack)
    force = plate_force(speed, 0.0, 0.0, n_x, n_y, 0.0, area)
    drag, lift = -force * n_x, -force * n_y
    pressure = WATER_KG_M3 * speed**2 * area
    assert drag == pytest.approx(pressure * math.sin(attack) ** 2, abs=1e-9)  # (7.9)
    assert lift == pytest.approx(pressure * math.cos(attack) * math.sin(attack), abs=1e-9)  # (7.10)
    assert plate_force(speed, 0.0, 0.0, -n_x, -n_y, 0.0, area) == pytest.approx(-force)
    assert plate_force(-speed, 0.0, 0.0, n_x, n_y, 0.0, area) == pytest.approx(-force)
