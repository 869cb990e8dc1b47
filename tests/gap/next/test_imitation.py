"""What a rival can imitate of another one's predictions: no more than its bounds and the recorded data allow."""

import numpy as np
import pytest
from swings import dataset_of, swing

from labrun.fit import Problem
from labrun.gap.averaging import averaged
from labrun.gap.next.imitation import Imitation, Recorded
from labrun.gap.recalibration import as_stated
from labrun.models import parse_model

# of all parameters the inertia alone may move, by three tolerances of 3 %
PENDULUM = """
name = "hinge"
states = ["angle", "rate"]
[parameters]
inertia   = { value = 1.2e-3, tolerance = 0.03, unit = "kg m^2" }
stiffness = { value = 0.13, tolerance = 0.0, unit = "N m/rad" }
[equations]
angle = "rate"
rate  = "-stiffness*angle/inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[initial]
angle = "first"
rate  = 0.0
"""


@pytest.fixture(scope="module")
def pendulum():
    model = parse_model(PENDULUM, "hinge.toml")
    problem = as_stated(Problem.of(model, averaged(dataset_of([swing(0.3, duration_s=1.0)]), model)))
    z = problem.begin()
    return problem, z, [shared[:, 0] for shared in problem.jacobian(z).shared]


def moved(pendulum, size, known):
    problem, z, slopes = pendulum
    imitation = Imitation(problem, z, known)
    change = imitation.change([-size * slope for slope in slopes])
    return -float(imitation.moved(change, [0])[0]), imitation.remaining(change, [0])


def test_a_small_change_of_a_parameter_is_imitated_by_that_parameter(pendulum):
    size, remaining = moved(pendulum, 0.05, np.zeros((1, 1)))
    assert abs(size) == pytest.approx(0.05, rel=1e-6)
    assert remaining == pytest.approx(0.0, abs=1e-9)


def test_a_parameter_moves_no_further_than_its_bounds(pendulum):
    problem, z, _ = pendulum
    room = max(abs(problem.priors.upper[0] - z[0]), abs(problem.priors.lower[0] - z[0]))
    size, remaining = moved(pendulum, 0.5, np.zeros((1, 1)))
    assert abs(size) == pytest.approx(room, rel=1e-6)
    assert remaining > 0.0


def test_recorded_data_hold_a_parameter_back_and_show_the_move_as_an_error(pendulum):
    problem, z, _ = pendulum
    recorded = Recorded(problem, z)
    free, _ = moved(pendulum, 0.05, np.zeros((1, 1)))
    held, remaining = moved(pendulum, 0.05, recorded.information)
    assert abs(held) < 0.6 * abs(free)
    assert remaining > 0.0
    assert np.all(recorded.errors(np.array([held])) > 0.0)
