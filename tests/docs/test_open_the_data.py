"""The page and the notebook about stored data say what works."""

import json
import re
import subprocess
from pathlib import Path

import h5py
import pytest
from forked_labrun import forked_programs, run_labrun

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "open-the-data.md"
NOTEBOOK = DOCS / "notebooks" / "open-a-run.ipynb"
A_SMALL_SWEEP = (
    "--set", "sweep.axes.b=[0]", "--set", "sweep.axes.a=[30, 60]", "--set", "sweep.axes.f=[1.0, 1.4]",
    "--set", "leaders={count=2, repeats=2}", "--seed", "7",
)  # fmt: skip


def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)


def _run_labrun(*arguments: str, folder: Path) -> None:
    done = run_labrun(*arguments, cwd=folder)
    assert done.returncode == 0, done.stderr


def _run_python(program: str, folder: Path) -> None:
    (folder / "program.py").write_text(program, encoding="utf-8")
    done = subprocess.run(
        [forked_programs() / "forked-python", "program.py"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def workspace(tmp_path_factory) -> Path:
    """Return a folder in which the page's first command was given, on fewer conditions."""
    folder = tmp_path_factory.mktemp("workspace")
    prompt, *command = _blocks("console")[0].split()
    assert (prompt, command[0]) == ("$", "labrun")
    _run_labrun(*command[1:], *A_SMALL_SWEEP, folder=folder)
    return folder


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(workspace):
    pytest.importorskip("pandas")
    notebook = json.loads(NOTEBOOK.read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells), "the notebook is kept without output"
    _run_python("\n".join("".join(cell["source"]) for cell in cells), workspace)


def test_the_python_of_the_page_runs_and_the_comments_hold(workspace):
    pytest.importorskip("pandas")
    checks = """
import numpy as np
assert run.trials.attrs["units"]["thrust"] == "N"
mine = run.signals("wrench", trial=12)
np.testing.assert_array_equal(trial.torque_y, mine.torque_y)
np.testing.assert_array_equal(tared, mine.torque_y)
np.testing.assert_array_equal(raw.torque_y - raw.torque_y.attrs["tare"], mine.torque_y)
assert table.thrust.values.tolist() == run.trials.thrust.tolist()
assert set(np.unique(good.trial_index)) == set(done.index)
"""
    _run_python("\n".join([*_blocks("python"), checks]), workspace)


def test_what_the_matlab_lines_read_is_there(workspace):
    (run,) = workspace.glob("results/fin-params/*/run.h5")
    (matlab,) = _blocks("matlab")
    with h5py.File(run) as file:
        attributes = re.findall(r"h5readatt\(file, '([^']+)', '([^']+)'\)", matlab)
        assert attributes
        assert all(name in file[path].attrs for path, name in attributes)
        reads = re.findall(r"h5read\(file, '([^']+)'(.*?)\);", matlab)
        assert len(reads) == matlab.count("h5read(")
        first, count = (int(file[f"wrench/{name}"][12]) for name in ("first_sample", "sample_count"))
        for path, part in reads:
            if part:
                assert part == ", first(row) + 1, count(row)"
                assert (file["wrench/trial_index"][first : first + count] == file["index"][12]).all()
            assert file[path].ndim == 1


def test_the_exports_of_the_page_work(workspace):
    lines = [line for block in _blocks("console") for line in block.splitlines() if " export " in line]
    assert len(lines) == 2
    for line in lines:
        _run_labrun(*line.removeprefix("$ labrun ").split(), folder=workspace)
        assert (workspace / line.split()[-1]).stat().st_size > 0
