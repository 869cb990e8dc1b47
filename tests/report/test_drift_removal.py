"""Drift of the bench, taken out of a table of trials."""

import csv
import json

import pytest
from typer.testing import CliRunner

from labrun.cli.app import app
from labrun.experiment import find_experiment, load_experiment
from labrun.store import RunFolder, TrialOutcome

SLOPE_PER_S = 0.1 / 3600


@pytest.fixture
def make_run(tmp_path):
    """Store a run whose bench drifts linearly, with so many reference trials among 12 trials."""
    loaded = load_experiment(find_experiment("fin-params", tmp_path))
    (objective, *_) = loaded.experiment.objectives

    def make(references, starts_s=tuple(600.0 * k for k in range(12))):
        folder = RunFolder.create(tmp_path / "results", "fin", loaded.resolved_toml, {"seed": 1})
        for index, started_s in enumerate(starts_s):
            role = "reference" if index % 3 == 0 and index < 3 * references else "measure"
            value = 1.0 + SLOPE_PER_S * started_s
            folder.writer(index).finish(
                TrialOutcome(
                    index,
                    {"x": 1.0},
                    0,
                    role,
                    started_s=started_s,
                    duration_s=1.0,
                    objectives={objective: value},
                ),
                None,
                None,
            )
        return folder.path, objective

    return make


def export(path, *arguments):
    return CliRunner().invoke(app, ["export", str(path), *arguments])


def test_a_column_more_is_as_if_all_had_been_measured_at_the_start(make_run, tmp_path):
    path, objective = make_run(4)
    done = export(path, "--to", "csv", "--remove-drift", "--output", str(tmp_path / "out.csv"), "--json")
    assert done.exit_code == 0, done.output
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row[f"{objective}_drift_corrected"]) for row in rows] == pytest.approx([1.0] * 12)
    assert float(rows[-1][objective]) == pytest.approx(1.0 + SLOPE_PER_S * 6600)
    (removed,) = [item for item in json.loads(done.stdout)["drift_removed"] if item["objective"] == objective]
    assert removed["slope_per_h"] == pytest.approx(0.1)


@pytest.mark.parametrize("references", [0, 2])
def test_too_few_reference_trials_are_a_wrong_request(make_run, references):
    done = export(make_run(references)[0], "--to", "csv", "--remove-drift")
    assert done.exit_code == 2
    assert "reference trials" in done.output


def test_a_clock_that_began_anew_is_a_wrong_request(make_run):
    starts_s = (*(600.0 * k for k in range(6)), *(600.0 * k for k in range(6)))
    done = export(make_run(4, starts_s)[0], "--to", "csv", "--remove-drift")
    assert done.exit_code == 2
    assert "its clock restarted" in done.output


def test_netcdf_holds_what_was_measured(make_run):
    done = export(make_run(4)[0], "--to", "netcdf", "--remove-drift")
    assert done.exit_code == 2
