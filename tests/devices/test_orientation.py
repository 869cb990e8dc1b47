"""Joint and Euler angles from orientations, against SciPy's rotations."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from labrun.devices import EulerAngles, HingeAngle, OrientationAngles, unknown_bodies

AXIS = np.array([0.6, -0.3, 0.74])
ORDERS = ["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def hinge(**keys):
    return HingeAngle.model_validate({"to": "outer", "axis": AXIS.tolist(), **keys})


def moved(rng, count):
    """The inner body anywhere, the outer turned against it about the axis; orientations and angles."""
    angle = np.linspace(-3.0, 3.0, count)
    inner = Rotation.random(count, random_state=rng)
    outer = inner * Rotation.from_rotvec(angle[:, None] * AXIS / np.linalg.norm(AXIS))
    return np.stack([inner.as_quat(), outer.as_quat()], axis=1), angle


def test_a_hinge_angle_is_the_turn_about_its_axis_wherever_the_bodies_are(rng):
    seen, angle = moved(rng, 61)
    angles = OrientationAngles(["inner", "outer"], {"theta": hinge(**{"from": "inner"})}, {})
    assert [channel.name for channel in angles.channels] == ["theta"]
    np.testing.assert_allclose(angles.of(seen)[:, 0], angle, atol=1e-12)


def test_its_sign_goes_on_through_zero_whichever_sign_the_quaternions_have(rng):
    seen, angle = moved(rng, 61)
    flipped = seen * rng.choice([-1.0, 1.0], size=(61, 2, 1))
    angles = OrientationAngles(["inner", "outer"], {"theta": hinge(**{"from": "inner"})}, {})
    np.testing.assert_allclose(angles.of(flipped)[:, 0], angle, atol=1e-12)


def test_without_another_body_it_is_the_turn_in_the_room():
    turn = Rotation.from_rotvec([[0.0, 0.4, 0.0]])
    angles = OrientationAngles(["outer"], {"theta": hinge(axis=[0, 2, 0])}, {})
    np.testing.assert_allclose(angles.of(turn.as_quat()[:, None]), [[0.4]])


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_are_those_of_the_order_asked_for(order, rng):
    turned = Rotation.random(20, random_state=rng)
    angles = OrientationAngles(["tip"], {}, {"tip": EulerAngles(body="tip", order=order)})
    assert [channel.name for channel in angles.channels] == ["tip_rx", "tip_ry", "tip_rz"]
    expected = turned.as_euler(order.upper())[:, [order.index(axis) for axis in "xyz"]]
    np.testing.assert_allclose(angles.of(turned.as_quat()[:, None]), expected, atol=1e-9)


def test_euler_angles_may_be_those_against_another_body(rng):
    seen, _ = moved(rng, 7)
    angles = OrientationAngles(
        ["inner", "outer"], {}, {"e": EulerAngles.model_validate({"body": "outer", "from": "inner"})}
    )
    between = Rotation.from_quat(seen[:, 0]).inv() * Rotation.from_quat(seen[:, 1])
    np.testing.assert_allclose(angles.of(seen), between.as_euler("XYZ"), atol=1e-9)


def test_a_body_that_is_not_tracked_is_told():
    (fault,) = unknown_bodies(["outer"], {"theta": hinge(**{"from": "innr"})}, {})
    assert "angle theta is of body 'innr', which is not among bodies ['outer']" in fault


def test_an_axis_without_direction_is_refused():
    with pytest.raises(ValidationError, match=r"\[0, 0, 0\] has none"):
        hinge(axis=[0, 0, 0])


def test_what_is_asked_for_survives_a_dump():
    asked = hinge(**{"from": "inner"})
    assert HingeAngle.model_validate(asked.model_dump()) == asked
