"""A recording made elsewhere becomes a run like any other."""

from pathlib import Path

import numpy as np
import pytest

from labrun.errors import RecordingError
from labrun.store.locate import find_run
from labrun.store.reading import import_recording, open_run

TOML = """\
experiment = "swing"
[channels.torque]
kind = "input"
unit = "N m"
between = "hold"
[channels.angle]
kind = "output"
unit = "rad"
[[trials]]
file = "a.csv"
condition = { release = 20, body = "wide" }
[[trials]]
file = "b.csv"
condition = { release = 20, body = "wide" }
"""


def recording(folder, rows="0.0,1.0,0.1\n0.1,2.0,0.2\n0.35,3.0,0.3\n"):
    folder.mkdir(parents=True)
    (folder / "recording.toml").write_text(TOML)
    for name in ("a", "b"):
        (folder / f"{name}.csv").write_text("time_s,torque,angle\n" + rows)
    return folder


def test_every_trial_comes_in_with_its_times_unchanged(tmp_path):
    path = import_recording(recording(tmp_path / "swing"), tmp_path / "results")
    assert find_run("swing", tmp_path / "results") == path
    run = open_run(path)
    assert run.name == "swing"
    assert [(outcome.condition, outcome.repeat) for outcome in run.outcomes] == [
        ({"release": 20, "body": "wide"}, 0),
        ({"release": 20, "body": "wide"}, 1),
    ]
    assert {outcome.status for outcome in run.outcomes} == {"done"}
    expected = (("input", "torque", "N m", [1, 2, 3]), ("output", "angle", "rad", [0.1, 0.2, 0.3]))
    for name, channel, unit, values in expected:
        stream = run.signals(1)[name]
        assert (stream.columns[0], stream.units[0]) == (channel, unit)
        np.testing.assert_array_equal(stream.time_s, [0.0, 0.1, 0.35])
        np.testing.assert_array_equal(stream.column(channel), values)
    assert run.command(0).columns == ()
    assert run.provenance["imported_from"] == str(tmp_path / "swing")
    assert run.events[-1]["event"] == "finished"


def test_a_recording_with_faults_leaves_no_run(tmp_path):
    with pytest.raises(RecordingError, match=r"a\.csv:3"):
        import_recording(
            recording(tmp_path / "swing", rows="0.0,1.0,0.1\n0.0,2.0,0.2\n"), tmp_path / "results"
        )
    assert not list(tmp_path.glob("results/*/*"))


@pytest.mark.parametrize(
    "name",
    ["../../evil", "..", ".", "/evil", "a/b", "a\\\\b", ".hidden", "end.", " ", "a\\u0000b", "n" * 121],
)
def test_a_name_that_is_not_one_folder_is_refused_with_file_and_line(tmp_path, name):
    folder = recording(tmp_path / "inner" / "swing")
    path = folder / "recording.toml"
    path.write_text(path.read_text().replace('"swing"', f'"{name}"'))
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(
        RecordingError, match=r"recording\.toml:1:\d+: experiment = (.|\n)* the name of one folder"
    ):
        import_recording(folder, tmp_path / "inner" / "results")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_recording_without_a_name_has_its_folders_wherever_it_is_read_from(tmp_path, monkeypatch):
    folder = recording(tmp_path / "swing 1")
    path = folder / "recording.toml"
    path.write_text(path.read_text().replace('experiment = "swing"', ""))
    (folder / "inner").mkdir()
    monkeypatch.chdir(folder / "inner")
    run = import_recording(Path(".."), tmp_path / "results")
    assert run.parent == tmp_path / "results" / "swing 1"


@pytest.mark.parametrize("name", ["ring-down", "xl330-servo", "emps", "silverbox"])
def test_the_real_recordings_come_in_whole(recordings, tmp_path, name):
    from labrun.store.recording import read_recording

    measured = read_recording(recordings / name)
    run = open_run(import_recording(recordings / name, tmp_path))
    assert len(run.outcomes) == len(measured.trials)
    for index, trial in enumerate(measured.trials):
        stream = run.signals(index)["output"]
        np.testing.assert_array_equal(stream.values, trial.outputs)
        np.testing.assert_array_equal(stream.time_s, trial.time_s)
