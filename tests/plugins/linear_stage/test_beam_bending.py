"""The shipped experiment on the beam bench: what comes out of its dry run, and of its model."""

import contextlib
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from labrun.app.fit import fit
from labrun.cli.app import app
from labrun.experiment import load_experiment, shipped_experiments
from labrun.models import load_model, simulate
from labrun.store import open_run


def labrun(folder, *arguments):
    with contextlib.chdir(folder):
        return CliRunner().invoke(app, arguments)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("beam")
    done = labrun(folder, "run", "beam-bending", "--dry-run", "--seed", "5", "--json")
    assert done.exit_code == 0, done.output
    return folder, folder / json.loads(done.stdout)["run"]


def test_all_trials_are_accepted_and_go_as_far_as_they_were_sent(finished):
    run = open_run(finished[1])
    assert [outcome.status for outcome in run.outcomes] == ["done"] * 6
    for outcome in run.outcomes:
        sense = np.sign(outcome.condition["reach"])
        assert sense * outcome.objectives["way"] == pytest.approx(0.025, abs=1e-4)
        expected = 5.0 if sense > 0 else 1.2  # K angle; equal-sense limit and what comes on top of it
        assert sense * outcome.objectives["greatest"] == pytest.approx(expected, rel=0.12)


def test_the_intervals_of_the_fit_hold_stiffness_limit_and_loop_of_the_beams_that_are_clamped(finished):
    result = fit(finished[1], results=finished[0], starts=1)
    truth = {"stiffness": 2.0, "limit": 0.1, "buckled_stiffness": 0.1, "loop": 0.003}
    for name, value in truth.items():
        low, high = result.parameters[name].ci95
        assert low < value < high
        assert result.parameters[name].value == pytest.approx(value, rel=0.1)
    assert any("3 mountings" in warning for warning in result.warnings)


def test_a_run_that_was_stopped_goes_on_to_the_same_numbers(finished):
    folder, path = finished
    done = labrun(
        folder,
        "run",
        "beam-bending",
        "--dry-run",
        "--seed",
        "5",
        "--limit",
        "3",
        "--results",
        "cut",
        "--json",
    )
    cut = folder / json.loads(done.stdout)["run"]
    assert labrun(folder, "resume", str(cut)).exit_code == 0
    whole, parts = open_run(path), open_run(cut)
    assert [outcome.objectives for outcome in parts.outcomes] == [
        outcome.objectives for outcome in whole.outcomes
    ]


def test_the_motion_stays_within_its_limits_and_the_sources_range():
    experiment = load_experiment(shipped_experiments() / "beam-bending.toml").experiment
    reach_m = [np.radians(condition["reach"]) * 0.1 for condition in experiment.run.conditions]
    assert max(reach_m) - min(reach_m) == pytest.approx(0.05, rel=0.01)  # 50 mm in all, as the source bends
    low, high = experiment.rig.devices["stage"].settings["limits"]["travel_m"]
    assert low <= min(reach_m) and max(reach_m) <= high


def test_the_model_buckles_in_equal_sense_alone():
    model = load_model(shipped_experiments() / "models" / "curved-beam.toml")
    time_s = np.linspace(0.0, 50.0, 501)
    slopes = {}
    for sense in (1.0, -1.0):
        displacement = sense * 0.025 * time_s / 50.0
        force = simulate(model, time_s, displacement[:, None]).outputs[:, 0]
        late = time_s > 30.0
        slopes[sense] = np.polyfit(displacement[late], force[late], 1)[0] * 0.1**2
    assert slopes[1.0] == pytest.approx(1.5, rel=1e-3)
    assert slopes[-1.0] == pytest.approx(0.05, rel=1e-3)
