"""The leaders of the turning search in open water, timed by a person."""

import pytest

import labrun
from labrun.experiment import load_experiment, shipped_experiments


@pytest.mark.slow
def test_every_gait_is_tried_in_each_water_with_and_without_the_tail(tmp_path):
    path = shipped_experiments() / "field-turn.toml"
    experiment = load_experiment(path).experiment
    assert experiment.run.conditions.experiments == ["turn-torque"]
    assert set(experiment.run.conditions.names) == {
        "gait",
        "alpha_1",
        "alpha_2",
        "beta_1",
        "beta_2",
        "f",
        "phi",
    }
    assert experiment.by_hand.names == ["water", "caudal"]
    plan = labrun.check(path, results=tmp_path)
    assert plan.trials == 8 * 2 * 2 * 3
    plan.require_feasible()
