"""What is typical at a site: what effects are measured in."""

import numpy as np
import pytest

from labrun.gap.averaging import averaged
from labrun.gap.candidates import site_scales
from labrun.gap.recalibration import stated_problem
from labrun.models import parse_model

from .benches import PENDULUM, recorded

CONDITIONS = ((0.02, 0.6), (0.03, 0.9))
DATASET = recorded(conditions=CONDITIONS, repeats=1)


def scales(text):
    model = parse_model(text, "pendulum.toml")
    problem = stated_problem(model, averaged(DATASET, model))
    return site_scales(problem, problem.priors.stated)


def test_an_output_is_measured_in_nearly_the_largest_that_was_recorded_of_it():
    outputs = np.concatenate([trial.outputs for trial in DATASET.trials])
    assert scales(PENDULUM)["output", "angle"].signal == pytest.approx(np.percentile(np.abs(outputs), 99))


def test_a_site_whose_coordinate_nothing_depends_on_has_a_scale_all_the_same():
    whole = scales(PENDULUM)["joint", "hinge"]
    found = scales(PENDULUM.replace('coordinate = "angle"', 'coordinate = "0"'))["joint", "hinge"]
    assert found.rate == pytest.approx(whole.rate)
    assert found.coordinate == pytest.approx(whole.rate * whole.time_s / (2 * np.pi))
