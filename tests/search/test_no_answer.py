"""A run that answers nothing is no success, and one on a restless bench says so."""

import io
import json

import pytest
from rich.console import Console
from typer.testing import CliRunner

from labrun.app.report import read_findings
from labrun.app.resume import resume
from labrun.cli.app import app
from labrun.errors import ExperimentError
from labrun.report.terminal import print_findings
from labrun.search import RunResult
from labrun.store import RunFolder, open_run


@pytest.fixture
def nothing(write):
    """Return a function that writes a sweep whose objective has a value for so many trials only."""

    def make(first=0, goal=True):
        path = write("sweep")
        text = path.read_text().replace(
            'plugin = "cycle-mean"', f'plugin = "no_numbers:Nothing"\nfirst = {first}'
        )
        path.write_text(text if goal else text.replace('goal = "maximise"\n', ""))
        return path

    return make


@pytest.mark.parametrize("goal", [True, False])
def test_a_run_without_an_accepted_trial_is_an_error_with_its_reasons_and_its_data_packed(
    nothing, dry_run, tmp_path, goal
):
    with pytest.raises(ExperimentError) as caught:
        dry_run(nothing(goal=goal))
    text = str(caught.value)
    (run,) = (tmp_path / "results" / "sweep").iterdir()
    assert text.startswith("no trial was accepted (0 done, 0 rejected, 18 failed)")
    assert "18 x failed: objective thrust of wrench.force_x is nan" in text
    assert f"kept and packed in {run}" in text
    assert "labrun resume" not in text
    assert (run / "run.h5").is_file()
    with open_run(run) as stored:
        assert len(stored.outcomes) == 18
    assert [event["event"] for event in RunFolder.open(run).journal.events()][-1] == "finished"


def test_resuming_a_run_that_answered_nothing_says_so_again(nothing, dry_run, tmp_path):
    with pytest.raises(ExperimentError) as first:
        dry_run(nothing())
    (run,) = (tmp_path / "results" / "sweep").iterdir()
    with pytest.raises(ExperimentError) as second:
        resume(run, draw=False)
    assert str(second.value) == str(first.value)


def test_a_goal_without_a_best_is_an_error(nothing, dry_run):
    with pytest.raises(
        ExperimentError, match=r"nothing can be named that would maximise thrust.*12 done"
    ) as caught:
        dry_run(nothing(first=12))
    assert caught.value.details["trials"]["done"] == 12
    assert caught.value.details["best"] is None


def test_at_the_shell_it_is_exit_code_1_with_the_counts_for_scripts(nothing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["sweep", str(nothing()), "--dry-run", "--json", "--seed", "5"])
    assert done.exit_code == 1
    record = json.loads(done.stdout)
    assert record["trials"] == {"done": 0, "rejected": 0, "failed": 18}
    assert "no trial was accepted" in record["error"]


def test_the_result_shows_the_most_frequent_reasons(tmp_path):
    reasons = {f"failed: reason {n}": 9 - n for n in range(6)}
    text = RunResult(tmp_path, 3, 0, 39, None, None, finished=True, reasons=reasons).to_text()
    assert "  9 x failed: reason 0\n" in text
    assert "reason 5" not in text
    assert "  9 x other reasons" in text


def test_reasons_that_differ_in_a_measured_number_only_are_one(tmp_path):
    reasons = {
        f"rejected: wrench.force_x = {-0.5 - n / 7} N is outside -0.5 ... 1: stopped": 1 for n in range(9)
    }
    reasons["rejected: wrench.force_y = 2 N is outside -1 ... 1: stopped"] = 2
    text = RunResult(tmp_path, 3, 11, 0, None, None, finished=True, reasons=reasons).to_text()
    assert "  9 x rejected: wrench.force_x = -0.5 N is outside -0.5 ... 1: stopped, or nearly so\n" in text
    assert "  2 x rejected: wrench.force_y = 2 N is outside -1 ... 1: stopped\n" in text
    assert "other reasons" not in text


def test_a_bench_that_never_settles_is_warned_of_wherever_the_result_is_shown(write, dry_run, recorder):
    path = write("sweep")
    rule = 'settle = { until = "quiet", below = 1e-9, hold_s = 1, timeout_s = 3 }'
    path.write_text(path.read_text().replace('settle = { until = "time", hold_s = 1 }', rule))
    result = dry_run(path, progress=recorder)
    counted = [outcome.settle.reason for outcome in RunFolder.open(result.run).outcomes().values()]
    late = counted.count("timeout")
    assert late > result.done / 2
    share = f"({100 * late / result.done:.0f} %)"
    warning = (
        f"{late} of {result.done} accepted trials {share} were recorded before the bench had come to rest"
    )
    assert result.best is not None
    assert warning in result.to_text()
    assert any(warning in note for note in recorder.notes)
    events = list(RunFolder.open(result.run).journal.events())
    assert [(e["trials"], e["of"]) for e in events if e["event"] == "unsettled"] == [(late, result.done)]
    assert resume(result.run, draw=False) == result
    console = Console(width=300, file=io.StringIO())
    with open_run(result.run) as run:
        print_findings(read_findings(run), console)
    assert warning in console.file.getvalue()


def test_a_bench_that_settles_is_not_warned_of(write, dry_run):
    assert "warning" not in dry_run(write("sweep")).to_text()
