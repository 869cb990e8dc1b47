"""The torque that a log holds is never dropped without a word, and what would be read can be seen first."""

import numpy as np
import pytest
import robot_logs as logs
from test_importing_logs import URDF
from typer.testing import CliRunner

from labrun.app.logs import LogAnswers, import_log, preview_log
from labrun.cli.app import app
from labrun.errors import RequestError


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace('"shoulder"', '"Joint1"'))
    return path


def numbered_log(tmp_path):
    time_s, goals, angles = logs.motion()
    names = ["t", "tau_con1", "pos_meas1"]
    return logs.write_csv(tmp_path / "log.csv", time_s, goals[:, :1], angles[:, :1], names)


def test_mapping_an_angle_asks_about_the_torque_beside_it(tmp_path, urdf):
    log = numbered_log(tmp_path)
    with pytest.raises(RequestError, match="tau_con1 may be the torque") as asked:
        import_log(log, urdf, tmp_path / "recording", mapping=["Joint1=pos_meas1"])
    assert "proposal: --map Joint1_torque=tau_con1" in str(asked.value)
    answers = ["Joint1=pos_meas1", "Joint1_torque=tau_con1"]
    result = import_log(log, urdf, tmp_path / "recording", mapping=answers)
    assert dict(result.channels) == {"Joint1_torque": "tau_con1", "Joint1": "pos_meas1"}


def test_a_torque_that_is_left_out_on_request_is_told(tmp_path, urdf):
    answers = ["Joint1=pos_meas1", "Joint1_torque=none"]
    result = import_log(numbered_log(tmp_path), urdf, tmp_path / "recording", mapping=answers)
    assert "not used: tau_con1" in result.remarks


def test_torques_beside_goals_are_told_not_to_be_used(tmp_path):
    arm = tmp_path / "arm.xml"
    arm.write_text(logs.ARM)
    time_s, goals, angles = logs.motion()
    names = ["time_s", "shoulder_cmd", "elbow_cmd", "shoulder_pos", "elbow_pos", "shoulder_effort"]
    log = logs.write_csv(tmp_path / "log.csv", time_s, goals, np.column_stack([angles, angles[:, 0]]), names)
    assert "not used: shoulder_effort" in import_log(log, arm, tmp_path / "recording").remarks


def test_a_preview_shows_every_channel_and_asks_without_writing(tmp_path, urdf, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = numbered_log(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    shown = CliRunner().invoke(app, ["import", str(log), "--model", str(urdf), "--dry-run"])
    assert shown.exit_code == 0
    for word in ("Joint1", "pos_meas1", "100", "-0.003", "question:", "nothing was written"):
        assert word in shown.output
    assert sorted(tmp_path.rglob("*")) == before


def test_a_preview_counts_what_an_import_would_leave_out(tmp_path):
    arm = tmp_path / "arm.xml"
    arm.write_text(logs.ARM)
    time_s, goals, angles = logs.motion()
    angles[300] = np.nan
    angles[600:, 0] += 2 * np.pi
    kept = (time_s < 8.0) | (time_s > 8.4)
    log = logs.write_csv(tmp_path / "log.csv", time_s[kept], goals[kept], angles[kept])
    preview = preview_log(log, arm)
    shoulder = next(channel for channel in preview.channels if channel.channel == "shoulder")
    assert (shoulder.column, shoulder.unit, shoulder.gaps, shoulder.samples) == (
        "shoulder_pos",
        "rad",
        1,
        kept.sum() - 1,
    )
    assert shoulder.rate_hz == pytest.approx(100)
    assert shoulder.highest == pytest.approx(0.8, abs=0.01)
    message = " ".join(preview.remarks)
    for part in (
        "1 sample without a number is left out",
        "1 gap of more than",
        "jumps by 6.28319 between two samples once",
    ):
        assert part in message
    result = import_log(log, arm, tmp_path / "recording", answers=LogAnswers())
    assert result.remarks == preview.remarks
    assert result.trials == preview.trials
