"""labrun as a Python package: its functions are the commands."""

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

import labrun
from labrun.cli.app import app
from labrun.errors import PlanError, RequestError, StoreError


def test_dir_lists_the_api():
    assert {"run", "resume", "check", "fit", "diagnose", "propose_next", "open", "report", "export"} <= set(
        dir(labrun)
    )


def test_every_name_of_the_api_is_a_function_whatever_was_imported_before():
    from labrun.fit import Dataset
    from labrun.report.text import duration_text

    assert Dataset
    assert duration_text
    assert all(callable(getattr(labrun, name)) for name in dir(labrun) if not name.startswith("_"))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    results = tmp_path_factory.mktemp("results")
    small = ["run.conditions=[{release=30}]", "trial.repeats=2", "trial.duration_s=2.5"]
    return labrun.run("hinge", dry_run=True, seed=1, overrides=small, results=results).run


def test_a_run_is_made_opened_and_reported_by_functions(run):
    assert len(labrun.open(run)) == 2
    assert labrun.report(run) == run / "report.html"
    written, removed = labrun.export(run, "csv")
    assert written.read_text().count("\n") == 3
    assert removed == []


def test_the_latest_run_is_reported_where_nobody_names_one(run):
    assert labrun.report(results=run.parent.parent) == run / "report.html"


def test_without_any_run_it_says_how_to_make_one(tmp_path):
    with pytest.raises(RequestError, match="no run yet") as raised:
        labrun.report(results=tmp_path)
    assert "--dry-run" in str(raised.value.hint)


@pytest.mark.parametrize("use_case", [labrun.fit, labrun.diagnose])
def test_a_folder_that_cannot_be_written_to_is_told_before_anything_is_computed(use_case, run, monkeypatch):
    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    notes = []
    with pytest.raises(StoreError, match="nothing was computed"):
        use_case(run, note=notes.append)
    assert notes == []


def test_a_recording_has_a_report_of_its_name_here_and_is_left_as_it_is(tmp_path, monkeypatch):
    recording = tmp_path / "swing"
    recording.mkdir()
    (recording / "0.csv").write_text("time_s,angle\n0,0.1\n0.1,0.2\n0.2,0.1\n")
    (recording / "recording.toml").write_text(
        'experiment = "let-go"\n[channels.angle]\nkind = "output"\nunit = "rad"\n[[trials]]\nfile = "0.csv"\n'
        "condition = { release = 0.1 }\n"
    )
    before = sorted(path.name for path in recording.iterdir())
    monkeypatch.chdir(tmp_path)
    written = labrun.report(recording)
    assert written.resolve() == tmp_path / "let-go-report.html"
    assert "angle" in written.read_text()
    assert sorted(path.name for path in recording.iterdir()) == before


@pytest.mark.parametrize(
    "command",
    [
        ["show", "table-7-2"],
        ["report", "table-7-2"],
        ["export", "table-7-2", "--to", "csv"],
    ],
)
def test_a_recording_that_ships_is_read_by_its_name(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "table-7-2" in done.output


def test_a_recording_is_opened_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording = labrun.open("table-7-2")
    assert recording.path.name == "table-7-2"
    with pytest.raises(RequestError, match="cannot find the run 'table-7-3x'") as raised:
        labrun.open("table-7-3x")
    assert "did you mean the recording" in str(raised.value.hint)


def test_a_plan_that_does_not_fit_on_the_disk_is_refused_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(total=10**9, used=10**9, free=10_000))
    with pytest.raises(PlanError, match="are free"):
        labrun.run("hinge", dry_run=True, seed=1, results=tmp_path / "results")
    assert not list(tmp_path.iterdir())
