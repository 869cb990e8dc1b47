"""A solver as a device: computed once a condition, read strictly, ended when it takes too long."""

import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import labrun
from labrun.errors import LabrunError
from labrun.store import open_run

SOLVER = """
import sys
angle, output = float(sys.argv[1]), sys.argv[2]
open("count.txt", "a").write("x")
{before}
with open(output, "w") as file:
    file.write("angle,moment\\n")
    for row in range(20):
        file.write(f"{{row * angle / 19}},{{{value}}}\\n")
"""
FILE = """
title = "A solver"
kind = "run"
[rig.devices.fea]
plugin = "command"
run = ["{python}", "solver.py", "{{angle}}", "{{output}}"]
channels = {{ angle = "deg", moment = "N m" }}
timeout_s = {timeout}
[trial]
duration_s = 0.4
[run]
conditions = [{{ angle = 10 }}, {{ angle = 20 }}]
[objectives.peak]
plugin = "peak"
channel = "fea.moment"
"""


@pytest.fixture
def solve(tmp_path, monkeypatch):
    """Return a function that runs the experiment with a solver, and one that counts how often it was started."""
    monkeypatch.chdir(tmp_path)

    def run(*, before="", value="row * angle", timeout=60, **keys):
        (tmp_path / "solver.py").write_text(SOLVER.format(before=textwrap.dedent(before), value=value))
        (tmp_path / "fea.toml").write_text(FILE.format(python=sys.executable, timeout=timeout))
        return labrun.run("fea.toml", seed=1, draw=False, **keys)

    count = tmp_path / "count.txt"
    run.started = lambda: len(count.read_text()) if count.exists() else 0
    return run


def test_each_condition_is_computed_and_its_table_is_a_trial(solve):
    result = solve()
    with open_run(result.run) as run:
        peaks = {outcome.condition["angle"]: outcome.objectives["peak"] for outcome in run.outcomes}
        curve = run.signals(0)["fea"]
    assert peaks == pytest.approx({10.0: 190.0, 20.0: 380.0})
    np.testing.assert_allclose(np.diff(curve.time_s[:20]), 0.01, atol=1e-6)


def test_one_row_is_held_through_the_trial(solve):
    alone = """
        with open(output, "w") as file:
            file.write(f"angle,moment\\n{angle},{3 * angle}\\n")
        sys.exit()
    """
    with open_run(solve(before=alone).run) as run:
        assert {outcome.condition["angle"]: outcome.objectives["peak"] for outcome in run.outcomes} == {
            10.0: 30.0,
            20.0: 60.0,
        }
        assert len(run.signals(0)["fea"].time_s) > 20


def test_a_condition_is_computed_once_also_in_later_runs(solve):
    solve(overrides=["trial.repeats=3"])
    assert solve.started() == 2
    solve()
    assert solve.started() == 2


def test_a_dry_run_starts_nothing_and_plays_what_was_computed_else_zeros(solve):
    with open_run(solve(dry_run=True).run) as run:
        assert [outcome.objectives["peak"] for outcome in run.outcomes] == [0.0, 0.0]
    assert solve.started() == 0
    solve(overrides=["run.conditions=[{ angle = 10 }]"])
    with open_run(solve(dry_run=True).run) as run:
        peaks = {outcome.condition["angle"]: outcome.objectives["peak"] for outcome in run.outcomes}
    assert peaks == pytest.approx({10.0: 190.0, 20.0: 0.0})
    assert solve.started() == 1


def test_a_dry_run_says_that_a_program_is_not_there(solve):
    with pytest.raises(LabrunError, match="cannot find the program 'abaqvs'"):
        solve(dry_run=True, overrides=['rig.devices.fea.run=["abaqvs"]'])


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (
            {"before": "print('mesh too coarse'); sys.exit(3)"},
            "ended with code 3; it said last: mesh too coarse",
        ),
        ({"before": "sys.exit(0)"}, "it wrote no file {output}"),
        ({"value": "'nonsense'"}, "line 2: moment = 'nonsense' is not a number"),
        ({"value": "float('nan')"}, "line 2: moment = 'nan' is not a number"),
        ({"value": "f'{row},{row}'"}, "line 2: 3 values under 2 headings"),
        ({"before": "import time; time.sleep(60)", "timeout": 0.3}, "took longer than timeout_s = 0.3 s"),
    ],
)
def test_what_a_solver_does_wrong_is_said_and_what_was_computed_stays(solve, changes, complaint):
    with pytest.raises(LabrunError) as error:
        solve(**changes)
    assert complaint in str(error.value)
    Path("solver.py").write_text(SOLVER.format(before="", value="row * angle"))
    assert labrun.resume().done == 2  # the run goes on once the solver is mended


def test_a_program_that_is_not_there_and_a_name_that_no_condition_has_are_said(solve, tmp_path):
    with pytest.raises(LabrunError, match="cannot find the program 'abaqvs'"):
        solve(overrides=['rig.devices.fea.run=["abaqvs"]'])
    with pytest.raises(LabrunError, match="names what the condition does not have; it has angle"):
        solve(overrides=[f'rig.devices.fea.run=["{sys.executable}", "{{theta}}"]'])
