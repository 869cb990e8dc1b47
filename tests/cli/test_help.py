"""What a person sees before anything runs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from forked_labrun import run_labrun
from typer.main import get_command

from labrun.cli.app import app

COMMANDS = sorted(get_command(app).commands)  # type: ignore[attr-defined]


def _labrun(*arguments: str, cwd=None) -> subprocess.CompletedProcess[str]:
    return run_labrun(*arguments, cwd=cwd or Path.cwd())


def test_the_commands_are_those_of_the_guide():
    text = " ".join(COMMANDS)
    assert text == (
        "check cmaes compare design doctor export fit gap import init keys list new plugins rank report resume run "
        "show sweep track watch"
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_json_and_an_example(name):
    shown = _labrun(name, "--help").stdout
    assert "--json" in shown
    assert f"Example:  labrun {name}" in shown


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        (["--help"], ["numpy", "pydantic", "numba", "scipy", "h5py", "matplotlib", "rich", "cma"]),
        (["check", "hinge"], ["matplotlib", "jinja2", "mujoco", "sklearn", "rosbags", "pyarrow"]),
    ],
)
def test_a_command_imports_nothing_heavy_that_it_does_not_use(arguments, heavy):
    script = (
        f"import sys\nfrom labrun.cli import main\nsys.argv = ['labrun', *{arguments}]\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stderr.strip() == "[]"


def test_the_version_comes_from_the_package():
    from importlib.metadata import version

    assert _labrun("--version").stdout.strip() == f"labrun {version('labrun')}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("sweep", "fin-parms", "--dry-run"), "fin-params"),
        (("sweep", "hinge", "--dry-run"), "labrun run hinge"),
        (("run", "hinge", "--dry-run", "--set", "trial.repeat=2"), "repeats"),
        (("run", "hinge", "--dry-run", "--set", "trial.duration_ms=2"), "duration_s"),
        (("fit", "hinge"), "labrun run hinge --dry-run"),
        (("show", "nothing-like-this"), "labrun list"),
        (("resume",), "results"),
    ],
)
def test_a_wrong_request_exits_with_2_and_says_what_would_do(arguments, message, tmp_path):
    done = _labrun(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "results").exists()


def test_an_error_is_one_json_object_for_a_script(tmp_path):
    done = _labrun("sweep", "fin-parms", "--dry-run", "--json", cwd=tmp_path)
    assert done.returncode == 2
    assert "fin-parms" in json.loads(done.stdout)["error"]


@pytest.mark.parametrize(
    ("command", "typed", "offered"),
    [
        ("run", "turn", ["turn-torque", "turn-torque-current"]),
        (
            "cmaes",
            "f",
            ["fire-attachment", "flapping", "forward-16d", "forward-pectoral", "forward-symmetric"],
        ),
        ("track", "s", ["spm-history", "spm-open-loop", "spm-pretrained", "spm-transfer", "stabilise"]),
    ],
)
def test_completion_offers_the_experiments_that_the_command_runs(
    tmp_path, monkeypatch, command, typed, offered
):
    monkeypatch.chdir(tmp_path)
    asked = {
        "COMP_WORDS": f"labrun {command} {typed}",
        "COMP_CWORD": "2",
        "_LABRUN_COMPLETE": "complete_bash",
    }
    done = subprocess.run(
        [sys.executable, "-c", "import sys; sys.argv[0] = 'labrun'; from labrun.cli import main; main()"],
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stdout.split() == offered


def test_a_word_that_is_no_choice_is_told_with_the_choices_alone(tmp_path):
    done = _labrun("new", "my-arm", "--devices", "dynamixel", "--kind", "swep", cwd=tmp_path)
    assert done.returncode == 2
    assert "'--kind': 'swep' is not one of 'run', 'sweep'" in done.stderr


def assert_ends_with_one_line(program: str) -> None:
    """Assert that a program that Ctrl-C meets ends with 130, one line on standard error and nothing else."""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 130
    assert done.stdout == ""
    assert done.stderr.startswith("labrun: interrupted by Ctrl-C")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("reading", ["labrun.cli.app", "labrun.cli.gap", "labrun.app.logs"])
def test_ctrl_c_while_the_program_is_being_read_ends_it_in_one_line(reading):
    """At the imports that every command takes, and at those of one."""
    program = f"""
import sys
from labrun.cli import main
class Interrupting:
    def find_spec(self, name, *_):
        if name == "{reading}":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
sys.argv = ["labrun", "import", "log.csv", "--model", "arm.xml"]
main()
"""
    assert_ends_with_one_line(program)


def test_ctrl_c_in_a_callback_of_compiled_code_which_drops_it_ends_the_program_all_the_same():
    """As while a law is being compiled."""
    program = """
import ctypes, sys, time
from labrun.cli import main
@ctypes.CFUNCTYPE(None)
def callback():
    raise KeyboardInterrupt
class Compiling:
    def find_spec(self, name, *_):
        if name == "labrun.app.logs":
            callback()
            time.sleep(300)
sys.meta_path.insert(0, Compiling())
sys.argv = ["labrun", "import", "log.csv", "--model", "arm.xml"]
main()
"""
    assert_ends_with_one_line(program)


def test_ctrl_c_while_a_command_is_being_parsed_is_told(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("typer.core.TyperGroup.parse_args", interrupted)
    with pytest.raises(SystemExit) as ended:
        get_command(app).main(["list"])
    assert ended.value.code == 130
    assert capsys.readouterr().err == "labrun: interrupted by Ctrl-C\n"
