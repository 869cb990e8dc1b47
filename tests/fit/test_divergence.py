"""Fits of what is unstable in open loop say that the simulation diverges, those of what is not say nothing."""

import numpy as np
import pytest

from labrun.fit import Problem, divergence_warnings, load_dataset
from labrun.models import load_model

MODEL = """
name = "swing"
states = ["angle", "rate"]
[parameters]
spring = {{ value = {spring}, tolerance = 0.1, unit = "1/s^2" }}
[equations]
angle = "rate"
rate = "-spring*angle"
[outputs]
angle = "angle"
[initial]
angle = "first"
rate = "free"
"""
TIME_S = np.arange(0, 4, 0.05)


def warnings_of(folder, spring: float) -> list[str]:
    rows = [f"{time:.2f},{0.1 * np.cos(3 * time):.5f}" for time in TIME_S]
    (folder / "swing.csv").write_text("\n".join(["time_s,angle", *rows]) + "\n")
    (folder / "recording.toml").write_text(
        '[channels.angle]\nkind = "output"\nunit = "rad"\n[[trials]]\nfile = "swing.csv"\n'
    )
    (folder / "model.toml").write_text(MODEL.format(spring=spring))
    model = load_model(folder / "model.toml")
    problem = Problem.of(model, load_dataset(folder, model), substeps=4)
    return divergence_warnings(problem, problem.begin())


def test_a_pole_that_nothing_holds_in_the_simulation_is_said_to_diverge(tmp_path):
    (sentence,) = warnings_of(tmp_path, -9.0)
    assert sentence.startswith("the simulation diverges")
    assert "labrun gap diagnose" in sentence


@pytest.mark.parametrize("spring", [9.0, 400.0, 0.0])
def test_what_swings_or_coasts_does_not_diverge(tmp_path, spring):
    assert warnings_of(tmp_path, spring) == []


def test_a_state_that_no_output_shows_begins_where_it_is_and_not_far_away(tmp_path):
    warnings_of(tmp_path, 9.0)
    hidden = (
        MODEL.format(spring=8.0)
        .replace('"rate"]', '"rate", "unseen"]')
        .replace("-spring*angle", "-spring*angle + 1e-6*unseen")
    )
    hidden = hidden.replace("[outputs]", 'unseen = "-unseen^3"\n[outputs]') + 'unseen = "free"\n'
    (tmp_path / "model.toml").write_text(hidden)
    model = load_model(tmp_path / "model.toml")
    problem = Problem.of(model, load_dataset(tmp_path, model), substeps=4)
    assert np.abs(problem.begin()[problem.size :]).max() < 100
    assert np.isfinite(problem.simulated(problem.begin())[0]).all()
