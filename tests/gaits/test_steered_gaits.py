"""Gaits whose variables a loop sets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import SpecError
from labrun.experiment import GaitTable
from labrun.gaits import make_gait, steering_of

GAITS = {
    "sine": GaitTable(
        plugin="sine",
        let={"half": "a / 2"},
        joints={
            "one": {"offset_deg": "b", "amplitude_deg": "a", "frequency_hz": "f"},
            "two": {"offset_deg": 3, "amplitude_deg": "-half", "frequency_hz": "f", "phase_deg": "b"},
        },
    ),
    "formula": GaitTable(
        plugin="formula",
        let={"wave": "a * sin(2*pi*f*t)"},
        joints={"one": {"angle_deg": "b + wave", "frequency_hz": "f"}, "two": {"angle_deg": "f"}},
    ),
    "hold": GaitTable(plugin="hold", joints={"one": {"angle_deg": "a + b"}, "two": {"angle_deg": "f"}}),
}


@pytest.mark.parametrize("plugin", GAITS)
@settings(max_examples=30)
@given(a=st.floats(-60, 60), b=st.floats(-20, 20))
def test_with_constant_drives_a_steered_gait_is_the_gait_itself(plugin, a, b):
    gait = make_gait(GAITS[plugin])
    whole = gait.trajectory({"a": a, "b": b, "f": 1.4}, duration_s=2.0, rate_hz=50.0)
    steering = steering_of(gait, plugin, {"f": 1.4, "controller": "P"}, ["a", "b"])
    count = len(whole.time_s)
    steered = steering(whole.time_s, {"a": np.full(count, a), "b": np.full(count, b)})
    np.testing.assert_allclose(steered, whole.angle_rad, atol=1e-12)


@pytest.mark.parametrize("plugin", GAITS)
def test_a_drive_acts_at_its_own_moment(plugin):
    gait = make_gait(GAITS[plugin])
    steering = steering_of(gait, plugin, {"a": 10.0, "f": 1.4}, ["b"])
    time_s = np.linspace(0, 1, 11)
    moved = steering(time_s, {"b": np.where(time_s > 0.5, 5.0, 0.0)})[:, 0]
    still = steering(time_s, {"b": np.zeros(11)})[:, 0]
    np.testing.assert_allclose(np.degrees(moved - still), np.where(time_s > 0.5, 5.0, 0.0), atol=1e-12)


@pytest.mark.parametrize("plugin", ["sine", "formula"])
def test_a_loop_cannot_set_the_frequency(plugin):
    with pytest.raises(SpecError, match=r"frequency_hz of one.*depends on f"):
        steering_of(make_gait(GAITS[plugin]), plugin, {"a": 1.0, "b": 0.0}, ["f"])


def test_a_released_joint_cannot_be_steered():
    gait = make_gait(GaitTable(plugin="release", joints={"hinge": {"angle_deg": "a"}}))
    with pytest.raises(SpecError, match="cannot be steered"):
        steering_of(gait, "release", {}, ["a"])
