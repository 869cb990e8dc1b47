"""Every command as a script calls it: one JSON object on standard output, and an exit code that means something."""

import csv
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import h5py
import pytest

HINGE = (
    "hinge",
    "--dry-run",
    "--seed",
    "5",
    "--set",
    "run.conditions=[{release=20}, {release=40}]",
    "--set",
    "trial.repeats=2",
)
SWEEP = ("fin-params", "--dry-run", "--seed", "5", "--set", "sweep.axes={b=[0], a=[40, 60], f=[1.0, 1.4]}")
SEARCH = (
    "turn-torque", "--dry-run", "--seed", "5", "--set", "cmaes.population=6", "--set", "cmaes.parents=3",
    "--set", "cmaes.reevaluate=0", "--set", "cmaes.stop.iterations=2", "--set", "trial.repeats=1",
    "--set", "leaders={count=2, repeats=2}",
)  # fmt: skip


def _is_a_promised_result(results: dict, unit: str) -> None:
    assert set(results) >= {"run", "trials", "best"}
    assert set(results["trials"]) == {"done", "rejected", "failed"}
    low, high = results["best"]["objective"]["ci95"]
    assert low <= results["best"]["objective"]["value"] <= high
    assert results["best"]["objective"]["unit"] == unit
    assert isinstance(results["best"]["luckiest"], float)


@pytest.fixture(scope="module")
def finished(labrun_once):
    """A finished run of the hinge: what it told, and the folder it was made in."""
    labrun, folder = labrun_once
    done = labrun("run", *HINGE, "--json")
    assert done.code == 0, done.err
    return done.json, folder


@pytest.fixture
def hinge(finished, tmp_path) -> Path:
    """A copy of it, in the folder of the test."""
    message, folder = finished
    shutil.copytree(folder / "results", tmp_path / "results")
    return Path(message["run"])


def test_a_run_without_a_goal_has_no_best(finished):
    message, _ = finished
    assert message["trials"] == {"done": 4, "rejected": 0, "failed": 0}
    assert message["best"] is None


def test_a_sweep_names_an_honest_best(labrun):
    done = labrun("sweep", *SWEEP, "--json")
    assert done.code == 0, done.err
    _is_a_promised_result(done.json, "N")
    assert done.json["best"]["parameters"] == {"b": 0, "a": 60, "f": 1.4}


def test_a_search_names_an_honest_best(labrun):
    done = labrun("cmaes", *SEARCH, "--json")
    assert done.code == 0, done.err
    _is_a_promised_result(done.json, "N m")
    assert set(done.json["best"]["parameters"]) == {"alpha_1", "alpha_2", "beta_1", "beta_2", "f", "phi"}


def test_a_limited_run_is_resumed_to_the_result_of_a_whole_one(labrun, tmp_path):
    whole, part = tmp_path / "whole", tmp_path / "part"
    expected = labrun("sweep", *SWEEP, "--json", "--results", whole).json
    first = labrun("sweep", *SWEEP, "--json", "--limit", "5", "--results", part)
    assert first.code == 0
    assert first.json["best"] is None
    resumed = labrun("resume", "--json", "--results", part)
    assert resumed.code == 0, resumed.err
    assert resumed.json["best"] == expected["best"]
    again = labrun("resume", resumed.json["run"], "--json")
    assert (again.code, again.json["best"]) == (0, expected["best"])


def test_check_moves_nothing_and_reports_trials_time_disk_and_limits(labrun, tmp_path):
    done = labrun("check", "fin-params", "--json")
    assert done.code == 0, done.err
    assert done.json["conditions"] == 764
    assert done.json["trials"] >= 2292
    assert done.json["time_s"] > 0
    assert done.json["disk_bytes"] > 0
    assert done.json["joints"]["tail"]["speed_deg_s"] <= done.json["joints"]["tail"]["speed_limit_deg_s"]
    assert list(tmp_path.iterdir()) == []


def test_check_refuses_a_plan_that_leaves_a_limit(labrun):
    done = labrun("check", "fin-params", "--set", "rig.devices.tail.limits.angle_deg=[-50, 60]")
    assert done.code == 2
    assert "angle of tail" in done.err
    assert "-50 deg" in done.err


def test_fit_prints_parameters_with_intervals_errors_figure_and_warnings(labrun, hinge, tmp_path):
    done = labrun("fit", "hinge", "--json")
    assert done.code == 0, done.err
    assert set(done.json) >= {"parameters", "rmse", "figure", "warnings"}
    for name in ("stiffness", "damping", "stiffness_fourier", "damping_fourier"):
        low, high = done.json["parameters"][name]["ci95"]
        assert low <= done.json["parameters"][name]["value"] <= high
        assert done.json["parameters"][name]["unit"]
    assert (tmp_path / done.json["figure"]).read_bytes().startswith(b"\x89PNG")


def test_show_tells_the_findings(labrun, hinge):
    assert labrun("show", "hinge").code == 0
    assert labrun("show", hinge, "--json").json["trials"]


def test_export_writes_one_row_a_trial(labrun, hinge, tmp_path):
    done = labrun("export", "hinge", "--to", "csv", "--output", "trials.csv", "--json")
    assert done.code == 0, done.err
    with (tmp_path / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["index"]) for row in rows] == [0, 1, 2, 3]
    assert {"release", "repeat", "status", "swing"} <= {heading.partition(" (")[0] for heading in rows[0]}


def test_export_writes_netcdf(labrun, hinge, tmp_path):
    assert labrun("export", hinge, "--to", "netcdf", "--output", "run.nc").code == 0
    with h5py.File(tmp_path / "run.nc") as file:
        assert file["cameras/angle"].attrs["units"] == "rad"


def test_a_recording_is_imported_shown_exported_and_fitted(labrun, recordings):
    imported = labrun("import", recordings / "ring-down", "--json")
    assert imported.code == 0, imported.err
    run = imported.json["run"]
    assert labrun("show", run).code == 0
    assert labrun("export", run, "--to", "csv", "--output", "pieces.csv").code == 0
    fitted = labrun("fit", run, "--model", recordings / "ring-down" / "model.toml", "--json")
    assert fitted.code == 0, fitted.err
    assert fitted.json["rmse"]["angle"] == pytest.approx(0.00778, rel=0.02)
    assert labrun("resume", run).code == 2


def test_ctrl_c_keeps_the_data_prints_the_resume_line_and_exits_as_the_shell_says(command, tmp_path):
    with subprocess.Popen(
        [*command, "sweep", "fin-params", "--dry-run", "--json"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as process:
        while process.poll() is None and len(list(tmp_path.glob("results/*/*/trials/0*.h5"))) < 3:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    run = next(tmp_path.glob("results/*/*"))
    assert f"labrun resume {run.relative_to(tmp_path)}" in err
    assert json.loads(out)["run"] == str(run.relative_to(tmp_path))
    assert len(list(run.glob("trials/0*.h5"))) >= 3
