"""The spherical mechanism: both kinematics undo one another, and the matrices are derivatives of the rotation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.rigs.spherical_mechanism import kinematics

from labrun.errors import ModelError

ANGLES = st.floats(np.radians(-85.0), np.radians(85.0))


def _printed_forward(theta_1, theta_2):
    """(2.5)-(2.7) as the source prints them."""
    t1, t2 = np.tan(theta_1), np.tan(theta_2)
    q = t1 + t1 * t2
    z = np.sqrt(1.0 / (q**2 + t2**2 + 1.0))
    return np.array([t2 * z, q * z, z])


def _square(side_deg):
    entry = np.radians(np.linspace(-side_deg, side_deg, 41))
    return np.meshgrid(entry, entry)


@given(ANGLES, ANGLES)
def test_the_inverse_gives_back_the_servo_angles_of_the_forward_kinematics(theta_1, theta_2):
    np.testing.assert_allclose(
        kinematics.inverse(kinematics.forward(theta_1, theta_2)), (theta_1, theta_2), atol=1e-9
    )


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.05, 1))
def test_the_forward_kinematics_give_back_the_normal_of_the_inverse(x, y, z):
    normal = np.array([x, y, z]) / np.linalg.norm([x, y, z])
    np.testing.assert_allclose(kinematics.forward(*kinematics.inverse(normal)), normal, atol=1e-9)


def test_the_forward_kinematics_as_printed_are_no_inverse():
    returned = kinematics.inverse(_printed_forward(*np.radians([30.0, 20.0])))
    np.testing.assert_allclose(np.degrees(returned), [34.81, 20.00], atol=0.005)
    returned = kinematics.inverse(_printed_forward(*np.radians([30.0, -20.0])))
    np.testing.assert_allclose(np.degrees(returned), [17.97, -20.00], atol=0.005)


def test_the_true_closed_chain_of_right_angles_is_what_the_kinematics_describe():
    """Links keep their 90 degrees: p, r and the coupler's axis, fixed in the end-effector, stand as the arcs say."""
    first, second = _square(80.0)
    turn = kinematics.rotation(first, second)
    r = np.stack([np.zeros_like(first), np.sin(first), np.cos(first)], axis=-1)
    p = np.stack([np.cos(second), np.zeros_like(second), -np.sin(second)], axis=-1)
    np.testing.assert_allclose(turn[..., :, 0], p, atol=1e-12)
    np.testing.assert_allclose(np.sum(r * turn[..., :, 1], axis=-1), 0.0, atol=1e-12)


@given(ANGLES, ANGLES)
def test_the_third_column_of_the_rotation_is_the_normal(theta_1, theta_2):
    turn = kinematics.rotation(theta_1, theta_2)
    np.testing.assert_allclose(turn[:, 2], kinematics.forward(theta_1, theta_2), atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))
def test_the_jacobian_is_the_derivative_of_the_rotation(theta_1, theta_2):
    step = 1e-6
    expected = np.empty((3, 2))
    for axis in range(2):
        ahead, behind = np.array([theta_1, theta_2]), np.array([theta_1, theta_2])
        ahead[axis] += step
        behind[axis] -= step
        spin = (
            (kinematics.rotation(*ahead) - kinematics.rotation(*behind))
            / (2 * step)
            @ kinematics.rotation(theta_1, theta_2).T
        )
        expected[:, axis] = spin[2, 1], spin[0, 2], spin[1, 0]
    np.testing.assert_allclose(kinematics.jacobian(theta_1, theta_2), expected, rtol=1e-6, atol=1e-8)
    back = kinematics.inverse_jacobian(theta_1, theta_2) @ expected
    np.testing.assert_allclose(back, [[1, 0], [0, 1], [0, 0]], atol=1e-7)


def test_at_rest_each_servo_turns_the_end_effector_about_its_own_axis():
    np.testing.assert_allclose(kinematics.jacobian(0.0, 0.0), [[-1, 0], [0, 1], [0, 0]], atol=1e-15)


@pytest.mark.parametrize(("side_deg", "worst_deg"), [(5, 0.04), (10, 0.30), (15, 1.0), (20, 2.4), (30, 7.6)])
def test_the_linearisation_is_as_wrong_as_it_says(side_deg, worst_deg):
    angles = _square(side_deg)
    error = np.degrees(
        np.abs(kinematics.linearised_tilt(*angles) - kinematics.tilt(kinematics.forward(*angles)))
    )
    assert error[..., 0].max() == pytest.approx(worst_deg, rel=0.05)
    assert error[..., 1].max() < 1e-9


@pytest.mark.parametrize("y", [1.0, -1.0])
def test_a_normal_along_y_is_refused_as_singular(y):
    with pytest.raises(ModelError, match="singular pose"):
        kinematics.inverse([0.0, y, 0.0])
    with pytest.raises(ModelError, match="singular pose"):
        kinematics.inverse([[0.0, 0.0, 1.0], [0.0, y, 0.0]])


def test_with_the_normal_in_the_chassis_plane_the_sources_special_case_holds_with_its_sign():
    np.testing.assert_allclose(kinematics.inverse([1.0, 0.3, 0.0]), [0.0, np.pi / 2])
    np.testing.assert_allclose(kinematics.inverse([-1.0, 0.3, 0.0]), [0.0, -np.pi / 2])


@pytest.mark.parametrize("normal", [[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0]])
def test_what_is_no_direction_is_refused(normal):
    with pytest.raises(ModelError, match="must be a direction"):
        kinematics.inverse(normal)


def test_a_normal_below_the_chassis_is_refused():
    with pytest.raises(ModelError, match="below the chassis"):
        kinematics.inverse([0.1, 0.1, -1.0])


@pytest.mark.parametrize("angles", [(np.pi / 2, 0.0), (0.0, -np.pi / 2), (0.0, 2.0), (np.nan, 0.0)])
def test_servo_angles_at_or_beyond_90_degrees_are_refused(angles):
    with pytest.raises(ModelError, match="singular at"):
        kinematics.forward(*angles)
