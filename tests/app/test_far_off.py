"""A robot that as stated is far from its log is not diagnosed before somebody says so."""

import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from labrun.app.check_recording import check_recording, require_near
from labrun.app.logs import import_log
from labrun.cli.app import app
from labrun.errors import RequestError

sys.path.insert(0, str(Path(__file__).parents[1] / "logs"))
import robot_logs as logs


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(logs.ARM.replace('range="-2 2"', ""))
    return path


def imported(tmp_path, arm, factor):
    time_s, goals, angles = logs.motion()
    log = logs.write_csv(tmp_path / f"log{factor}.csv", time_s, factor * goals, angles)
    return import_log(log, arm, tmp_path / f"recording{factor}", unit="rad").folder


def test_goals_in_another_unit_than_angles_stop_the_diagnosis_and_are_told_by_the_check(tmp_path, arm):
    folder = imported(tmp_path, arm, 20)
    message = " ".join(check_recording(folder).remarks)
    assert "times as far off as it moves" in message
    with pytest.raises(RequestError, match=r"shoulder is simulated .* times as far off as it moves") as error:
        require_near(folder)
    assert "--anyway" in error.value.hint


def test_a_robot_near_its_log_and_a_joint_that_stands_still_are_no_reason_to_stop(tmp_path, arm):
    require_near(imported(tmp_path, arm, 1))
    time_s, goals, angles = logs.motion()
    goals[:, 1] = 0.05 * (time_s < 1e9)
    angles[:, 1] = 1e-3 * np.random.default_rng(1).standard_normal(len(time_s))
    log = logs.write_csv(tmp_path / "still.csv", time_s, goals, angles)
    require_near(import_log(log, arm, tmp_path / "still").folder)


def test_the_command_refuses_with_the_flag_that_goes_on(tmp_path, arm, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = CliRunner().invoke(app, ["gap", "diagnose", str(imported(tmp_path, arm, 20))])
    assert refused.exit_code == 2
    assert "--anyway" in refused.output
