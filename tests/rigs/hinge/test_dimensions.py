import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.rigs.hinge import dimensions
from labrun_plugins.rigs.hinge.polynomial import PUBLISHED

from labrun.errors import ModelError
from labrun.models import load_model, simulate

W, L, A = 50e-3, 1.75e-3, 43e-4


def published(quantity, **size_m):
    """Return a map of one size of the hinge, nominal otherwise."""
    return PUBLISHED[quantity, tuple(size_m)].value(size_m)


def test_all_corrected_maps_agree_at_the_nominal_specimen():
    assert published("stiffness", w=W) == pytest.approx(0.0148, abs=5e-5)
    assert published("stiffness", l=L) == pytest.approx(0.0143, abs=5e-5)
    assert dimensions.stiffness(W, L) == pytest.approx(0.0143, abs=5e-5)
    assert published("damping", a=A) == pytest.approx(4.3e-5, abs=5e-7)
    assert published("damping", w=W) == pytest.approx(4.5e-5, abs=5e-7)
    assert published("damping", l=L) == pytest.approx(4.3e-5, abs=5e-7)
    assert dimensions.damping(A, W, L) == pytest.approx(4.4e-5, abs=5e-7)


@pytest.mark.parametrize("length_m", [1e-3, 2e-3, 3e-3, 4e-3])
def test_both_maps_of_stiffness_over_length_agree_to_one_percent(length_m):
    assert dimensions.stiffness(W, length_m) == pytest.approx(published("stiffness", l=length_m), rel=0.011)


@given(st.floats(0, 0.01), st.floats(0.005, 0.06), st.floats(0.0005, 0.005))
def test_damping_is_positive_everywhere(area_m2, width_m, length_m):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dimensions.HingeMapWarning)
        assert dimensions.damping(area_m2, width_m, length_m) >= dimensions.LEAST_DAMPING
    assert published("damping", a=area_m2) > 1.6e-5
    assert published("damping", w=width_m) > 1.8e-5
    assert published("damping", l=length_m) > 2.2e-5


def test_damping_far_from_the_specimens_is_clamped_with_a_warning():
    with pytest.warns(dimensions.HingeMapWarning, match="far from the specimens"):
        assert dimensions.damping(2e-4, 30e-3, 4e-3) == dimensions.LEAST_DAMPING


def test_a_stiffness_that_is_not_positive_is_an_error():
    with pytest.raises(ModelError, match=r"\(3.12\).*does not hold there"):
        dimensions.stiffness(10e-3, 3e-3)


def test_the_hinge_pendulum_has_the_values_of_the_maps_and_swings_down():
    model = load_model("hinge-pendulum")
    values = {parameter.name: parameter.value for parameter in model.parameters}
    assert values["stiffness"] == pytest.approx(dimensions.stiffness(W, L), rel=0.01)
    assert values["damping"] == pytest.approx(dimensions.damping(A, W, L), rel=0.02)
    time_s = np.arange(0, 3, 1 / 360)
    angle = simulate(model, time_s, np.empty((len(time_s), 0)), initial_state=[0.5, 0.0]).outputs[:, 0]
    crossings = np.count_nonzero(np.diff(np.sign(angle)))
    small_swing_hz = np.sqrt((values["stiffness"] + values["gravity_torque"]) / values["inertia"]) / (
        2 * np.pi
    )
    assert crossings / 2 / 3 == pytest.approx(small_swing_hz, rel=0.06)
    assert np.abs(angle[-360:]).max() < 0.5 * np.exp(-values["damping"] / (2 * values["inertia"]) * 2) * 1.1
