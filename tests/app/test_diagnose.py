"""Where a diagnosis is kept."""

import json
from dataclasses import replace
from pathlib import Path

import gap_examples as examples
import pytest

from labrun.app.diagnose import store
from labrun.app.kept import FOLDER, kept_folder, read_stored
from labrun.errors import RequestError
from labrun.gap import Sizes
from labrun.store import find_data


@pytest.fixture
def recording(tmp_path):
    folder = tmp_path / "ring-down"
    folder.mkdir()
    (folder / "recording.toml").write_text('title = "a ring-down"\n')
    return folder


def test_a_run_keeps_its_diagnosis_in_its_own_folder(tmp_path):
    run = tmp_path / "results" / "hinge" / "hinge-1"
    run.mkdir(parents=True)
    stored = store(examples.explained(), kept_folder(run, tmp_path / "results", FOLDER))
    assert {path.name for path in (run / "gap").iterdir()} == {"diagnosis.json", "gap.html", "gap_figure.png"}
    assert read_stored(run)["causes"][0]["effect"] == "coulomb-friction"
    assert stored.to_json()["report"] == str(run / "gap" / "gap.html")


def test_a_diagnosis_made_again_stands_first_and_the_earlier_ones_are_kept_in_order(tmp_path):
    for made in (examples.explained(), examples.pair(), examples.no_gap()):
        store(made, tmp_path / FOLDER, page=False)
    assert read_stored(tmp_path)["verdict"] == "no-gap"
    kept = [json.loads((tmp_path / f"gap-{n}" / "diagnosis.json").read_text()) for n in (1, 2)]
    assert [len(loads["causes"]) for loads in kept] == [1, 2]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gap", "gap-1", "gap-2"]


def test_a_recording_is_never_written_to(recording, tmp_path):
    results = tmp_path / "results"
    first, second = (
        store(examples.no_gap(), kept_folder(recording, results, FOLDER), page=False) for _ in range(2)
    )
    assert [path.name for path in recording.iterdir()] == ["recording.toml"]
    assert first.numbers.parent.parent == results / "ring-down"
    assert first.numbers != second.numbers


@pytest.mark.parametrize(
    ("message", "name"),
    [
        ('experiment = "pendulum"', "pendulum"),
        ("", "ring-down"),
        ('experiment = "../out"', "ring-down"),
        ("= 3", "ring-down"),
    ],
    ids=["stated", "not stated", "no name of a folder", "no TOML"],
)
def test_an_answer_about_a_recording_is_kept_under_the_name_that_it_states(
    recording, tmp_path, message, name
):
    channel = '[channels.angle]\nkind = "output"\nunit = "rad"\n[[trials]]\nfile = "1.csv"\n'
    (recording / "recording.toml").write_text(f"{message}\n{channel}")
    for what in ("gap", "fit", "compare"):
        assert kept_folder(recording, tmp_path / "results", what).parent == tmp_path / "results" / name


def test_without_a_page_nothing_is_drawn(tmp_path):
    stored = store(examples.no_gap(), tmp_path / FOLDER, page=False)
    assert [path.name for path in (tmp_path / "gap").iterdir()] == ["diagnosis.json"]
    assert stored.to_json()["report"] is None
    assert stored.to_text(100)[-1].plain == f"report   {stored.numbers}"


def test_numbers_that_json_has_no_word_for_become_null(tmp_path):
    wild = replace(examples.no_gap(), gap=Sizes(float("inf"), 1.0, 1.0, 1.0))
    text = store(wild, tmp_path / FOLDER, page=False).numbers.read_text()
    assert json.loads(text)["gap"]["raw"] is None
    assert "Infinity" not in text


def test_the_object_of_the_contract_is_in_the_file(tmp_path):
    loads = json.loads(store(examples.pair(), tmp_path / FOLDER, page=False).numbers.read_text())
    assert {
        "verdict",
        "gap",
        "ladder",
        "causes",
        "rest",
        "candidates",
        "shrinkage",
        "complete",
        "stopped",
    } <= set(loads)
    lag = loads["causes"][1]
    assert lag["indistinguishable_from"][0]["effect"] == lag["rivals"][0]["effect"] == "delay"
    assert lag["refers_to"] == {"order": {"value": 1.0, "unit": "1"}}
    assert [rung["step"] for rung in loads["ladder"]][:2] == ["as stated", "recalibrated"]
    assert loads["ladder"][-1]["errors"]["angle"]["unit"] == "rad"
    assert loads["rest"]["depends_on"] == ["speed of hinge"]


def test_a_run_without_a_diagnosis_is_told_how_to_get_one(tmp_path):
    with pytest.raises(RequestError, match="has no diagnosis yet") as raised:
        read_stored(tmp_path)
    assert "labrun gap diagnose" in str(raised.value.hint)


@pytest.mark.parametrize("content", ["{", "[]", "{}"])
def test_a_file_that_is_no_diagnosis_is_not_taken_for_one(tmp_path, content):
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "diagnosis.json").write_text(content)
    with pytest.raises(RequestError, match=r"diagnosis\.json"):
        read_stored(tmp_path)


def test_a_recording_folder_is_meant_before_a_run_of_its_name(recording, monkeypatch):
    monkeypatch.chdir(recording.parent)
    assert find_data("ring-down", Path("results")) == Path("ring-down")
