"""`labrun gap`, as typed."""

import json

import pytest
from typer.testing import CliRunner

from labrun.cli.app import app


def typed(*arguments):
    return CliRunner().invoke(app, ["gap", *map(str, arguments)])


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("command", ["diagnose", "test", "compare", "plan", "next", "check", "reveal"])
def test_every_command_has_json_and_an_example(command):
    shown = typed(command, "--help").stdout
    assert "--json" in shown
    assert f"Example:  labrun gap {command}" in shown


@pytest.mark.parametrize("command", ["diagnose", "next", "reveal"])
def test_a_target_that_is_not_there_is_a_wrong_request(command):
    done = typed(command, "hinge")
    assert done.exit_code == 2
    assert "labrun run hinge --dry-run makes one" in done.stderr
    assert done.stdout == ""


def test_a_target_with_a_typo_names_the_nearest():
    assert "did you mean 'hinge'?" in typed("diagnose", "hinje").stderr


def test_an_error_is_one_json_object_for_a_script():
    done = typed("diagnose", "hinge", "--json")
    assert done.exit_code == 2
    assert "no run yet" in json.loads(done.stdout)["error"]


def test_a_place_that_cannot_hold_the_corrected_model_is_told_before_computing(tmp_path):
    folder = tmp_path / "ring-down"
    folder.mkdir()
    (folder / "recording.toml").write_text("")
    done = typed("diagnose", folder, "--save-model", tmp_path / "nowhere" / "corrected.toml")
    assert done.exit_code == 2
    assert "cannot find the folder" in done.stderr


def test_completion_offers_effects():
    from labrun.cli.gap import _effect_ids

    assert _effect_ids("coul") == ["coulomb-friction"]


def test_a_horizon_that_is_no_number_is_told_with_how_to_write_it():
    done = typed("test", "hinge-pendulum", "--fresh", "hinge", "--horizon", "0.1;2")
    assert done.exit_code == 2
    assert "--horizon 0.1,0.5,2" in done.stderr


@pytest.mark.parametrize(
    ("command", "lost", "called"),
    [
        (["diagnose", "hinge"], "diagnosis", "labrun.app.diagnose_robot.joint_by_joint"),
        (["diagnose", "hinge", "--whole"], "diagnosis", "labrun.app.diagnose.diagnose"),
        (["next", "hinge"], "experiment", "labrun.app.next.propose_next"),
    ],
)
def test_ctrl_c_says_that_nothing_was_written(command, lost, called, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(called, interrupted)
    done = typed(*command, "--json")
    assert done.exit_code == 130
    assert json.loads(done.stdout)["error"] == f"interrupted by Ctrl-C; no {lost} was written"
    assert "moved" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--tool", "no-such-program"], "'no-such-program' does not exist"),
        (["--tool", "true", "--tool-limit-s", "0"], "leaves a tool no time"),
        (["--tool", "true", "--only", "robots"], "--tool"),
        (["--tool", "true", "--cluster", "tcp://127.0.0.1:1"], "leave out --cluster"),
    ],
)
def test_a_tool_that_cannot_be_asked_is_refused_before_cases_are_made(tmp_path, arguments, words):
    done = typed("check", "--cases", 1, *arguments)
    assert done.exit_code == 2
    assert words in done.stderr
    assert not list(tmp_path.iterdir())
