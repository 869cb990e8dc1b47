"""The experiment that is proposed for a run is one that labrun checks, runs, and diagnoses together with the first."""

import pytest
from diagnosing import diagnose

from labrun.app.next import propose_next as propose
from labrun.app.run import run as execute
from labrun.errors import StoreError
from labrun.experiment import load_experiment, load_named
from labrun.gap.diagnose import Options
from labrun.gap.next.trials import beyond, by_hand, rounded
from labrun.runner import Planner

HIDDEN = ["quadratic-drag@hinge"]
SEED = 1
"""The simulated bench draws its specimen from it: a second run of the same specimen has the same."""


def dry_run(folder, name, overrides=()):
    loaded = load_named(name, folder, list(overrides))
    return execute(loaded, results=folder / "results", dry_run=True, seed=SEED, draw=False, hide=HIDDEN).run


@pytest.mark.slow
def test_from_a_run_to_its_next_experiment_and_to_the_diagnosis_of_both(tmp_path):
    first = dry_run(
        tmp_path, "hinge", ["run.conditions=[{release=10}]", "trial.repeats=3", "trial.duration_s=3"]
    )
    proposal = propose(first, workspace=tmp_path)
    assert proposal.outcome == "separates"
    assert proposal.file == tmp_path / "experiments" / "hinge-next.toml"
    loaded = load_experiment(proposal.file)
    conditions = loaded.experiment.run.conditions
    assert [dict(trial.condition) for trial in proposal.trials] == conditions
    Planner(loaded.experiment).plan(conditions).require_feasible()
    second = dry_run(tmp_path, "hinge-next")
    result = diagnose(first, more=[second], workspace=tmp_path, options=Options(places=False))
    assert [str(cause.name) for cause in result.causes] == ["quadratic-drag at hinge"]
    assert not {str(name) for name in result.causes[0].indistinguishable_from} & set(proposal.rivals)


def test_a_workspace_that_takes_no_file_is_told_before_anything_is_computed(tmp_path, monkeypatch):
    run = dry_run(
        tmp_path, "hinge", ["run.conditions=[{release=10}]", "trial.repeats=1", "trial.duration_s=1"]
    )

    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    notes = []
    with pytest.raises(StoreError, match=r"hinge-next\.toml could not be written"):
        propose(run, workspace=tmp_path, note=notes.append)
    assert notes == [f"reading {run}"]


def test_values_go_as_far_as_the_limit_and_to_the_other_side():
    results = beyond([10.0, 20.0], lambda value: -30.0 <= value <= 50.0)
    assert max(results) == pytest.approx(50.0, rel=0.01)
    assert min(results) == pytest.approx(-30.0, rel=0.01)
    assert all(-30.0 <= value <= 50.0 for value in results)
    assert not {10.0, 20.0, 0.0} & set(results)


def test_where_no_limit_speaks_values_stay_within_four_times_the_measured():
    assert max(beyond([1.0, 2.0], lambda _: True)) == 8.0


def test_a_mass_keeps_its_sign_and_an_orientation_changes_it():
    assert min(by_hand("payload_kg", [0.5])) > 0
    assert by_hand("up", [1.0]) == [-1.0]
    assert -10.0 in by_hand("tilt_deg", [10.0])


@pytest.mark.parametrize(
    ("value", "expected"), [(89.96, 89.9), (-89.96, -89.9), (0.0, 0.0), (0.0012345, 0.00123), (5.0, 5.0)]
)
def test_rounding_never_leads_away_from_zero(value, expected):
    assert rounded(value) == pytest.approx(expected, rel=1e-12)
