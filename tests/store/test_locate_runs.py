"""A run is found by what a person types, or the answer says what to type."""

import os

import pytest
import stored_runs

from labrun.errors import RequestError
from labrun.store.folder import RunFolder
from labrun.store.locate import find_run, find_unfinished


def test_a_name_means_the_latest_run(tmp_path):
    runs = [stored_runs.new_run(tmp_path).path for _ in range(3)]
    for number, run in enumerate(runs):
        os.utime(run / "spec.toml", ns=(number, number))
    later = runs[0].with_name("2199-01-01T00-00-00-aaaa")
    assert find_run("fin", tmp_path) == runs[2]
    runs[0].rename(later)
    assert find_run("fin", tmp_path) == later


def test_a_run_is_found_by_folder_file_name_or_letters(tmp_path):
    run = stored_runs.new_run(tmp_path)
    stored_runs.new_run(tmp_path)
    packed = run.pack()
    assert find_run(str(run.path), tmp_path) == run.path
    assert find_run(str(packed), tmp_path) == packed
    assert find_run(run.path.name, tmp_path) == run.path
    assert find_run(run.path.name[-4:], tmp_path) == run.path
    assert find_run(str(run.path.parent), tmp_path / "elsewhere") == find_run("fin", tmp_path)


def test_an_experiment_without_a_run_says_how_to_make_one(tmp_path, monkeypatch):
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "hinge.toml").write_text('title = "Hinge"\nkind = "run"\n')
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RequestError, match="hinge has no run yet") as refused:
        find_run("hinge", tmp_path / "results")
    assert "labrun run hinge --dry-run" in str(refused.value)


def test_a_misspelt_name_gets_the_nearest(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    RunFolder.create(tmp_path, "tail-thrust", stored_runs.SPEC, {})
    with pytest.raises(RequestError, match="did you mean 'tail-thrust'"):
        find_run("tail-trust", tmp_path)
    with pytest.raises(RequestError, match="experiments with runs: tail-thrust"):
        find_run("zzz", tmp_path)
    with pytest.raises(RequestError, match="has no runs yet"):
        find_run("zzz", tmp_path / "none")


def test_a_misspelt_folder_gets_the_nearest_beside_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recordings" / "arm").mkdir(parents=True)
    (tmp_path / "recordings" / "arm" / "recording.toml").touch()
    with pytest.raises(RequestError, match="did you mean 'recordings/arm'"):
        find_run("recordings/armm", tmp_path / "results")


def test_the_latest_run_that_did_not_finish_is_the_one_to_resume(tmp_path):
    first, second, third = (stored_runs.new_run(tmp_path) for _ in range(3))
    for number, run in enumerate((first, second, third)):
        os.utime(run.path / "spec.toml", ns=(number, number))
    third.journal.append("finished")
    assert find_unfinished(None, tmp_path) == second.path
    assert find_unfinished(str(first.path), tmp_path) == first.path
    assert find_unfinished(str(first.pack()), tmp_path) == first.path
    first.journal.append("finished")
    second.journal.append("finished")
    with pytest.raises(RequestError, match="waits to be resumed"):
        find_unfinished(None, tmp_path)
