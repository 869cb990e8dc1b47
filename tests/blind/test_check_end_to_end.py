"""Two cases of the generator, from their making to their scores."""

import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labrun.blind import Checked, check
from labrun.blind.check_folder import CheckFolder
from labrun.blind.diagnosis_check import case_seed
from labrun.blind.jobs import fingerprint
from labrun.errors import LabrunError, RequestError
from labrun.report.diagnosis_check import check_text, write_check_page
from labrun.workers import pool, spread

TWO_CASES: dict[str, Any] = {"cases": 2, "seed": 5, "first": 33}
"""Hysteresis of a static fin, far above the noise, and a control: made and diagnosed within seconds."""
KEPT_S = 12345.0


@pytest.fixture(scope="module")
def progress() -> list[str]:
    return []


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory, progress: list[str]) -> Path:
    """A check that Ctrl-C has stopped after its first diagnosis."""
    out = tmp_path_factory.mktemp("check") / "two"
    before = {child.pid for child in multiprocessing.active_children()}

    def announce(line: str) -> None:
        progress.append(line)
        progress.append("diagnosed already" if (out / "diagnoses").exists() else "nothing diagnosed yet")

    def interrupting(text: str) -> None:
        if (out / "diagnoses").exists() and "1 of 2" in text:
            raise KeyboardInterrupt

    with pytest.raises(LabrunError, match="every diagnosis that was finished is kept"):
        check(**TWO_CASES, workers=1, out=out, announce=announce, note=interrupting)
    assert not (out / "check.json").exists()
    for child in multiprocessing.active_children():
        if child.pid not in before:
            child.join(10.0)
            assert not child.is_alive()
    (kept,) = (out / "diagnoses").iterdir()
    kept.write_text(json.dumps({**json.loads(kept.read_text()), "processor_s": KEPT_S}))
    return out


@pytest.fixture(scope="module")
def checked(interrupted: Path) -> Checked:
    return check(**TWO_CASES, workers=2, out=interrupted, announce=silent)


@pytest.fixture
def local_cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        yield cluster


def copy_of(checked: Checked, folder: Path, *parts: str) -> Path:
    folder.mkdir()
    for part in ("cases", "fresh", "sealed", *parts):
        shutil.copytree(checked.folder / part, folder / part)
    shutil.copy(checked.folder / "seal.json", folder)
    shutil.copy(checked.folder / "asked.json", folder)
    return folder


def silent(_: str) -> None:
    pass


def without_seconds(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_seconds(item) for key, item in value.items() if key != "processor_s"}
    return [without_seconds(item) for item in value] if isinstance(value, list) else value


def test_the_seal_is_told_before_anything_is_diagnosed(checked: Checked, progress: list[str]) -> None:
    assert checked.seal in progress[0]
    assert progress[1:] == ["nothing diagnosed yet"]


def test_every_case_is_listed_with_what_was_hidden_and_what_was_said(checked: Checked) -> None:
    check = json.loads((checked.folder / "check.json").read_text())
    assert [case["case"] for case in check["cases"]] == ["case-0033", "case-0034"]
    effect, control = check["cases"]
    assert (control["kind"], control["hidden"]) == ("control", [])
    assert effect["hidden"] == [{"effect": "hysteresis", "site": "root"}]
    assert control["answer"]["causes"] == []
    assert effect["answer"]["gap"]
    page = write_check_page(checked).read_text()
    assert "hysteresis at root (static-fin)" in page
    assert check["figures"]["no_answer"] == {}


def test_what_a_screen_says_fits_one_and_names_the_use_of_the_seed(checked: Checked) -> None:
    text = check_text(checked)
    assert len(text.splitlines()) <= 40
    assert max(map(len, text.splitlines()[1:-1])) <= 110
    assert "seed 5 is one of development" in text


def test_an_announced_cause_is_held_against_fresh_trials(checked: Checked) -> None:
    effect = checked.judged[0]
    assert effect.causes
    assert effect.shown is not None
    assert effect.shown.error == ""
    assert effect.shown.value is not None
    assert effect.shown.value <= 1.0


def test_an_interrupted_check_goes_on_with_what_was_diagnosed(checked: Checked) -> None:
    assert [case.reply.processor_s == KEPT_S for case in checked.judged].count(True) == 1


def test_any_number_of_processes_finds_the_same(checked: Checked, tmp_path: Path) -> None:
    folder = copy_of(checked, tmp_path / "again", "diagnoses", "shrinkage")
    (folder / "diagnoses" / "case-0034.json").unlink()
    again = check(**TWO_CASES, workers=1, out=folder, announce=silent)
    assert without_seconds(again.to_json()) == without_seconds(checked.to_json())


def test_a_diagnosis_by_other_code_is_not_taken_for_one_of_this(checked: Checked, tmp_path: Path) -> None:
    folder = copy_of(checked, tmp_path / "older", "diagnoses")
    path = folder / "diagnoses" / "case-0033.json"
    reply = {**json.loads(path.read_text()), "programme": fingerprint()}
    path.write_text(json.dumps(reply))
    assert CheckFolder(folder).reply("case-0033", fingerprint()) == reply
    path.write_text(json.dumps({**reply, "programme": "older"}))
    assert CheckFolder(folder).reply("case-0033", fingerprint()) is None


def test_an_answer_that_was_changed_is_found_and_nothing_is_scored(checked: Checked, tmp_path: Path) -> None:
    folder = copy_of(checked, tmp_path / "changed", "diagnoses", "shrinkage")
    path = folder / "sealed" / "case-0034.json"
    path.write_text(path.read_text().replace('"control"', '"effect"'))
    with pytest.raises(LabrunError, match=r"case-0034\.json was changed after it was sealed"):
        check(**TWO_CASES, workers=1, out=folder, announce=silent)
    assert not (folder / "check.json").exists()


def test_answers_sealed_anew_are_not_those_whose_seal_was_told(checked: Checked, tmp_path: Path) -> None:
    folder = copy_of(checked, tmp_path / "sealed-anew", "diagnoses", "shrinkage")
    seal = json.loads((folder / "seal.json").read_text())
    (folder / "seal.json").write_text(json.dumps({**seal, "all": "0" * 64}))
    with pytest.raises(LabrunError, match="is not the seal that was printed"):
        check(**TWO_CASES, workers=1, out=folder, announce=silent)


def test_a_case_that_cannot_be_diagnosed_is_listed_without_an_answer(
    checked: Checked, tmp_path: Path
) -> None:
    folder = copy_of(checked, tmp_path / "broken", "diagnoses", "shrinkage")
    (folder / "diagnoses" / "case-0034.json").unlink()
    trial = folder / "cases" / "case-0034" / "trial001.csv"
    trial.write_text(trial.read_text().replace("torque", "toque"))
    again = check(**TWO_CASES, workers=1, out=folder, announce=silent)
    (reason,) = again.scores.unanswered.values()
    assert again.judged[1].outcome == "no-answer"
    assert "case-0034/trial001.csv" in reason
    assert "labrun-check-" not in reason


def test_a_tool_is_scored_beside_labrun_and_is_asked_once(checked: Checked, tmp_path: Path) -> None:
    folder = copy_of(checked, tmp_path / "with-a-tool", "diagnoses", "shrinkage")
    log, script = tmp_path / "asked.txt", tmp_path / "knows_one_answer.py"
    script.write_text(
        "import json, sys\n"
        f"open({str(log)!r}, 'a').write(sys.argv[-1][-9:] + ' ')\n"
        "if sys.argv[-1].endswith('34'): sys.exit('lost')\n"
        "print(json.dumps({'gap': True, 'causes': [{'effect': 'hysteresis', 'site': 'root'}]}))\n"
    )
    command = f"{sys.executable} {script}"
    for _ in range(2):
        again = check(**TWO_CASES, workers=1, out=folder, tools=[command], announce=silent)
    assert log.read_text().split() == ["case-0033", "case-0034"]
    assert without_seconds(again.labrun.to_json()) == without_seconds(checked.labrun.to_json())
    (tool,) = again.tools
    assert (tool.name, [case.outcome for case in tool.judged]) == ("knows_one_answer", ["named", "no-answer"])
    assert tool.scores.unanswered == {"case-0034": "ended with exit code 1: lost"}
    assert json.loads((folder / "check.json").read_text())["tools"][0]["figures"]["false_causes"] == 0


def test_a_tool_does_not_run_on_a_cluster(checked: Checked) -> None:
    with pytest.raises(RequestError, match="workers of a cluster do not have"):
        check(**TWO_CASES, cluster="tcp://127.0.0.1:1", tools=["true"], out=checked.folder, announce=silent)


def test_a_folder_of_another_check_is_refused(checked: Checked) -> None:
    with pytest.raises(
        RequestError, match="2 cases of seed 5, from case 33; requested is one of 2 cases of seed 9"
    ):
        check(cases=2, seed=9, first=33, workers=1, out=checked.folder, announce=silent)


def test_the_seed_of_a_diagnosis_depends_on_the_case_and_the_seed_alone() -> None:
    seeds = {case_seed(seed, f"case-{number:04d}") for seed in (1, 2) for number in range(1, 200)}
    assert len(seeds) == 398
    assert case_seed(7, "case-0012") == case_seed(7, "case-0012")


@pytest.mark.slow
def test_a_dask_cluster_finds_the_same_as_processes(
    checked: Checked, local_cluster: Any, tmp_path: Path
) -> None:
    address = local_cluster.scheduler_address
    assert address.startswith("tcp://")
    again = check(**TWO_CASES, cluster=address, out=copy_of(checked, tmp_path / "dask"), announce=silent)
    assert without_seconds(again.to_json()) == without_seconds(checked.to_json())


@pytest.mark.slow
def test_workers_of_a_cluster_that_die_are_an_error_that_says_so(local_cluster: Any) -> None:
    jobs = iter([("case", os._exit, (1,))])
    with (
        pytest.raises(LabrunError, match=r"gave up: .* died"),
        pool(1, local_cluster.scheduler_address) as there,
    ):
        list(spread(there, jobs))


@pytest.mark.slow
def test_a_scheduler_that_goes_away_is_an_error_that_says_so(local_cluster: Any) -> None:
    jobs: Iterator[tuple[str, Callable[..., Any], tuple[Any, ...]]]
    jobs = iter([("one", abs, (1,)), ("two", time.sleep, (60.0,))])
    with (
        pytest.raises(LabrunError, match="gave up: its scheduler is gone"),
        pool(1, local_cluster.scheduler_address) as there,
    ):
        for _ in spread(there, jobs):
            local_cluster.close()


def test_what_stopped_processes_leave_behind_is_taken_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(KeyboardInterrupt), pool(1, None) as there:
        for _, made in spread(there, iter([("folder", tempfile.mkdtemp, ())])):
            assert Path(made).is_dir()
            assert Path(made).parents[1] == tmp_path
            raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_without_dask_a_cluster_is_refused_with_what_to_install(
    checked: Checked, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(RequestError, match=r'pip install "labrun\[cluster\]"'):
        check(**TWO_CASES, cluster="tcp://127.0.0.1:1", out=checked.folder, announce=silent)
