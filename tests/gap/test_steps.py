"""Every trial takes as many of the integrator's steps as what acts in it asks for."""

import numpy as np
import pytest

from labrun.effects import Scale, load_effect
from labrun.fit import Problem
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate
from labrun.gap.diagnosis import Name
from labrun.gap.recalibration import stated_problem
from labrun.gap.steps import in_longer_steps, in_shorter_steps
from labrun.models import Model

from .benches import CONDITIONS, pendulum, recorded

FAR = 1
"""The condition that reaches the stop."""


@pytest.fixture(scope="module")
def stopped() -> tuple[Problem, np.ndarray]:
    """Return a problem with a hard stop that one of two conditions reaches, and where it stands."""
    model: Model = pendulum()
    problem = stated_problem(model, averaged(recorded(repeats=1, conditions=CONDITIONS[:2]), model))
    z = problem.priors.stated
    reach = [float(np.max(np.abs(one))) for one in problem.simulated(z)]
    assert reach[FAR] > 1.2 * reach[1 - FAR]
    level = 0.5 * sum(reach)
    attached = load_effect("end-stop").attach("hinge", upper=level, lower=-level, stiffness=200.0)
    candidate = Candidate(Name("end-stop", "hinge"), attached, Scale(), ())
    beside = candidate.added_to(problem)
    free = beside.priors.values[beside.priors.free] / beside.priors.scale
    return beside, np.concatenate([free, problem.own_states(z)])


def test_steps_are_shortened_in_the_trials_alone_where_that_changes_anything(stopped) -> None:
    problem, z = stopped
    finer = in_shorter_steps(problem, z, 1e-4 * problem.squares(z))
    assert finer.steps[FAR] > problem.steps[FAR]
    assert finer.steps[1 - FAR] == problem.steps[1 - FAR]


def test_steps_that_change_nothing_stay_as_they_are(stopped) -> None:
    problem, z = stopped
    assert in_shorter_steps(problem, z, problem.squares(z)) is problem


def test_steps_are_lengthened_again_in_the_trials_that_do_with_longer_ones(stopped) -> None:
    problem, z = stopped
    finer = problem.with_substeps(16)
    longer = in_longer_steps(finer, z, problem.steps)
    assert longer.steps[1 - FAR] < 16


def test_no_steps_are_longer_than_those_that_are_taken_at_least(stopped) -> None:
    problem, z = stopped
    assert in_longer_steps(problem, z, problem.steps) is problem
