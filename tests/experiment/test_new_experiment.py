"""A new file for any devices checks and dry-runs as it stands, with nothing named that would be simulated."""

from pathlib import Path

import pytest

from labrun.app.run import run
from labrun.errors import RequestError
from labrun.experiment import load_experiment, new_experiment


@pytest.mark.parametrize(
    ("devices", "kind"),
    [
        (["dynamixel", "ati-netft"], "sweep"),
        (["arduino-servo", "carriage-reset", "ati-daq"], "run"),
        (["dynamixel", "bno055", "ur5", "robotiq-ft300"], "cmaes"),
        (["operator", "optitrack"], "sweep"),
        (["linear-stage"], "run"),
        (["arduino-servo"], "sweep"),
        (["ati-netft"], "run"),
        (["ur5", "optitrack"], "sweep"),
        (["dynamixel", "ati-netft"], "track"),
    ],
)
def test_a_new_file_dry_runs_as_it_stands(tmp_path, devices, kind):
    path = new_experiment("first", devices, kind, tmp_path)
    result = run(path, dry_run=True, seed=1, limit=2, results=tmp_path / "results")
    assert (result.done, result.failed) == (2, 0), result.reasons
    assert load_experiment(path).experiment.kind == kind


def test_two_devices_of_a_kind_get_names_of_their_own(tmp_path):
    path = new_experiment("two", ["dynamixel", "optitrack", "optitrack"], "run", tmp_path)
    assert list(load_experiment(path).experiment.rig.devices) == ["dynamixel", "optitrack", "optitrack_2"]


@pytest.mark.parametrize(
    ("name", "devices", "kind", "message"),
    [
        ("a", ["dynamixl"], "run", "dynamixel"),
        ("a", ["optitrack"], "sweep", "actuator"),
        ("a", ["arduino-servo"], "track", "measured"),
        ("a", ["arduino-servo"], "cmaes", "sensor"),
        ("a", ["dynamixel", "dynamixel"], "run", "joint_1"),
        ("../a", ["dynamixel"], "run", "not a valid experiment name"),
        ("there", ["dynamixel"], "run", "there already"),
    ],
)
def test_what_cannot_be_written_is_told_and_nothing_is_written(tmp_path, name, devices, kind, message):
    (tmp_path / "there.toml").write_text("kept")
    with pytest.raises(RequestError) as error:
        new_experiment(name, devices, kind, tmp_path)
    assert message in str(error.value)
    assert [path.name for path in Path(tmp_path).iterdir()] == ["there.toml"]
    assert (tmp_path / "there.toml").read_text() == "kept"
