"""A recording made elsewhere, shown and exported like a run, also without an import."""

import csv
import io
import json
import tempfile

import pytest
from rich.console import Console

from labrun.app.carry_out import draw
from labrun.app.report import read_findings
from labrun.app.resume import resume
from labrun.errors import RequestError
from labrun.report.live import LiveProgress
from labrun.report.terminal import print_findings
from labrun.store import export_run, import_recording, open_target

TOML = """\
experiment = "swing"
[channels.torque]
kind = "input"
unit = "N m"
[channels.angle]
kind = "output"
unit = "rad"
"""


@pytest.fixture
def recording(tmp_path):
    folder = tmp_path / "recordings" / "swing"
    folder.mkdir(parents=True)
    text = TOML
    for number, (release, count) in enumerate([(20, 11), (20, 21), (40, 11)]):
        text += f'[[trials]]\nfile = "{number}.csv"\ncondition = {{ release = {release} }}\n'
        rows = [f"{0.1 * k},{k},{0.01 * k}" for k in range(count)]
        (folder / f"{number}.csv").write_text("\n".join(["time_s,torque,angle", *rows]))
    (folder / "recording.toml").write_text(text)
    return folder


def shown(run):
    console = Console(file=io.StringIO(), width=120)
    print_findings(read_findings(run), console)
    return console.file.getvalue()


def test_an_imported_recording_is_shown_with_channels_trials_and_origin(recording, tmp_path):
    run_folder = import_recording(recording, tmp_path / "results")
    with open_target("swing", tmp_path / "results") as run:
        findings = json.loads(json.dumps(read_findings(run).to_json(), allow_nan=False))
        text = shown(run)
    assert findings["kind"] == "recording"
    assert findings["run"] == str(run_folder)
    assert findings["imported_from"] == str(recording)
    assert findings["channels"] == [
        {"name": "torque", "kind": "input", "unit": "N m", "rate_hz": pytest.approx(10)},
        {"name": "angle", "kind": "output", "unit": "rad", "rate_hz": pytest.approx(10)},
    ]
    assert [(item["condition"], item["trials"]) for item in findings["conditions"]] == [
        ({"release": 20}, 2),
        ({"release": 40}, 1),
    ]
    assert findings["duration_s"] == pytest.approx(4)
    for expected in ("angle", "output", "rad", "10 Hz", "release = 20", "1 to 2 s", str(recording)):
        assert expected in text


def test_a_published_table_is_shown_with_its_numbers(tmp_path):
    folder = tmp_path / "speeds"
    folder.mkdir()
    text = '[source]\nkind = "publication"\n[channels.speed]\nkind = "output"\nunit = "m/s"\n'
    for gait, speed in (("rowing", 0.32), ("undulation", 0.16)):
        text += f'[[trials]]\nfile = "{gait}.csv"\ncondition = {{ gait = "{gait}" }}\n'
        (folder / f"{gait}.csv").write_text(f"time_s,speed\n0,{speed}\n")
    (folder / "recording.toml").write_text(text)
    with open_target(str(folder), tmp_path / "results") as run:
        text = shown(run)
    for expected in ("source: publication\n", "speed (m/s)", "rowing", "0.32", "0.16"):
        assert expected in text


def test_a_recording_folder_is_shown_as_it_would_be_imported_and_nothing_stays(
    recording, tmp_path, monkeypatch
):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    before = sorted(tmp_path.rglob("*"))
    with open_target(str(recording), tmp_path / "results") as run:
        findings = read_findings(run).to_json()
        assert "angle" in shown(run)
    assert sorted(tmp_path.rglob("*")) == before
    assert findings["run"] == findings["imported_from"] == str(recording)
    import_recording(recording, tmp_path / "results")
    with open_target("swing", tmp_path / "results") as run:
        assert read_findings(run).to_json() == {**findings, "run": str(run.path)}


def test_a_recording_folder_is_exported_to_the_current_directory_and_left_as_it_is(
    recording, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with open_target(str(recording), tmp_path / "results") as run:
        written = export_run(run, "csv")
        with pytest.raises(RequestError, match=r"0\.csv is there already"):
            export_run(run, "csv", recording / "0.csv")
    with written.open() as file:
        assert [row["release"] for row in csv.DictReader(file)] == ["20.0", "20.0", "40.0"]
    assert written.resolve() == tmp_path / "swing.csv"
    assert not (tmp_path / "results").exists()


def test_an_imported_recording_has_nothing_to_resume(recording, tmp_path):
    run_folder = import_recording(recording, tmp_path / "results")
    with pytest.raises(RequestError, match="nothing is left to resume"):
        resume(run_folder, progress=LiveProgress(Console(file=io.StringIO())))


def test_an_imported_recording_has_its_picture(recording, tmp_path):
    run_folder = import_recording(recording, tmp_path / "results")
    assert draw(run_folder, None).is_file()
