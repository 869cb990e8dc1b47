"""What any model could gain: of a gap that goes with the motion much, of noise nothing."""

import numpy as np
import pytest
from swings import dataset_of, swing

from labrun.gap.averaging import averaged
from labrun.gap.learnable import dependence, learnable_share
from labrun.gap.recalibration import Recalibrated, recalibrate
from labrun.models import load_model


def left_by(sensor):
    rng = np.random.default_rng(1)
    made = []
    for release in (0.5, 0.7, 0.9, 1.1):
        time_s, angle = swing(release, duration_s=3.0, rate_hz=120.0)
        made.append((time_s, angle + sensor(angle) + 1e-3 * rng.standard_normal(len(angle))))
    model = load_model("hinge-pendulum").with_values(
        {"inertia": 1.2e-3, "gravity_torque": 0.06, "stiffness": 0.0686}
    )
    return recalibrate(model, averaged(dataset_of(made), model), np.random.default_rng(0), lambda _: None)


@pytest.fixture(scope="module")
def noise() -> Recalibrated:
    return left_by(np.zeros_like)


@pytest.fixture(scope="module")
def error() -> Recalibrated:
    return left_by(lambda angle: 5e-3 * np.sin(5 * angle))


def test_of_noise_nothing_can_be_learned_and_of_an_error_that_goes_with_the_motion_much(noise, error):
    assert learnable_share(noise.problem, noise.z) < 0.1
    assert learnable_share(noise.problem, noise.z, conditions=True) < 0.1
    assert learnable_share(error.problem, error.z) > 0.2


def test_an_error_that_goes_with_the_position_is_said_to_depend_on_it(error):
    signals = dependence(error.problem, error.z, learnable_share(error.problem, error.z))
    assert set(signals) & {"position of hinge", "angle"}
    assert "speed of hinge" not in signals
