"""Checks of one kind of case: what is made, what nobody is told, what is refused, what is left out."""

import json
import pickle
import shutil
import subprocess
import sys
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

from labrun.blind import Checked, check
from labrun.blind.check_folder import SHIPPED_GENERATOR, CheckFolder, prepare
from labrun.blind.diagnosis_check import _diagnosed, kind_named
from labrun.blind.jobs import fingerprint
from labrun.blind.judging import KINDS, CauseName, Named, Said, Shown, Shrunk, Truth, judge
from labrun.blind.robot_check import ROBOT
from labrun.blind.scoring import score
from labrun.errors import LabrunError, RequestError
from labrun.report.diagnosis_check import check_page, check_text
from labrun.workers import Pool

TWO_CONTROLS: dict[str, Any] = {"cases": 2, "seed": 42, "first": 4, "only": "control"}
"""A static fin and a payload arm: made within seconds."""
LAG = CauseName("effect", "lag", "torque")
FRICTION = CauseName("effect", "coulomb-friction", "hinge")


def silent(_: str) -> None:
    pass


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> Checked:
    """Two controls, made and scored; in place of their diagnoses stands what is said of them here."""
    out = tmp_path_factory.mktemp("check") / "control-only"
    prepare(CheckFolder(out), **TWO_CONTROLS, workers=2, note=silent)
    for name in ("case-0004", "case-0005"):
        quiet = {"verdict": "no-gap", "causes": [], "seconds": 1.0, "programme": fingerprint()}
        CheckFolder(out).keep_said(name, quiet)
    return check(**TWO_CONTROLS, workers=1, out=out, announce=silent)


def of_kinds(*kinds: str, said: Said | None = None, folder: Path = Path("gap-check")) -> Checked:
    """Return a check of hand-made cases of these kinds, all of them told the same."""
    hidden = {"effect": (FRICTION,), "pair": (FRICTION, LAG), "parameter": (CauseName("parameter", "mass"),)}
    said = said or Said("", "no-gap", (), None, 1.0)
    judged = tuple(
        judge(Truth(f"case-{number:04d}", kind, hidden.get(kind, ()), 2.0, "hinge-drive", 3, 1, ()), said)
        for number, kind in enumerate(kinds, start=1)
    )
    only = kinds[0] if len(set(kinds)) == 1 else None
    return Checked(1, only, "0" * 64, folder, ("code",), judged, score(judged))


def test_all_cases_are_of_that_kind_and_the_folder_remembers_it(checked: Checked) -> None:
    assert [(one.truth.case, one.truth.kind) for one in checked.judged] == [
        ("case-0004", "control"),
        ("case-0005", "control"),
    ]
    assert json.loads((checked.folder / "asked.json").read_text())["only"] == "control"
    found = json.loads((checked.folder / "check.json").read_text())
    assert (found["only"], found["figures"]["kinds"]) == ("control", {"control": 2})
    assert found["figures"]["false_alarms"]["of"] + len(found["figures"]["errors"]) == 2


def test_the_same_call_goes_on_where_it_was(checked: Checked) -> None:
    path = checked.folder / "diagnoses" / "case-0004.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "seconds": 12345.0}))
    again = check(**{**TWO_CONTROLS, "only": "controls"}, workers=1, out=checked.folder, announce=silent)
    assert again.judged[0].said.seconds == 12345.0
    assert again.judged[1] == checked.judged[1]


@pytest.mark.parametrize(
    ("only", "words"), [("outside", r"2 cases \(only outside\) of seed 42"), (None, "2 cases of seed 42")]
)
def test_another_kind_in_the_same_folder_is_refused(checked: Checked, only: str | None, words: str) -> None:
    before = (checked.folder / "asked.json").read_bytes()
    with pytest.raises(RequestError, match=r"holds a check of 2 cases \(only control\).* is one of " + words):
        check(**{**TWO_CONTROLS, "only": only}, workers=1, out=checked.folder, announce=silent)
    assert (checked.folder / "asked.json").read_bytes() == before


def test_a_check_begun_before_kinds_could_be_asked_for_goes_on_as_one_of_the_mixture(tmp_path: Path) -> None:
    (tmp_path / "seal.json").write_text(json.dumps({"all": "ab", "cases": {"case-0001": "cd"}}))
    (tmp_path / "asked.json").write_text(json.dumps({"cases": 1, "seed": 7, "first": 1, "seal": "ab"}))
    folder = CheckFolder(tmp_path)
    assert folder.ask({"cases": 1, "seed": 7, "first": 1, "only": None}) == "ab"
    with pytest.raises(RequestError, match=r"asked for is one of 1 cases \(only pair\)"):
        folder.ask({"cases": 1, "seed": 7, "first": 1, "only": "pair"})


def test_cases_that_are_not_of_the_kind_asked_for_are_not_scored_as_such(
    checked: Checked, tmp_path: Path
) -> None:
    folder = tmp_path / "from-elsewhere"
    shutil.copytree(checked.folder, folder)
    for name in ("asked.json", "check.json"):
        (folder / name).unlink()
    with pytest.raises(RequestError, match="not of kind outside only: some are of kind control"):
        check(**{**TWO_CONTROLS, "only": "outside"}, workers=1, out=folder, announce=silent)
    assert not (folder / "check.json").exists()


class _Recording(Executor):
    """Keeps what is sent to a worker, as it travels, and answers without diagnosing."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def submit(self, job: Any, /, *arguments: Any, **_: Any) -> "Future[Any]":
        self.sent.append(pickle.dumps((job, arguments)))
        future: Future[Any] = Future()
        future.set_result({"verdict": "no-gap", "causes": [], "seconds": 0.0})
        return future


def test_what_travels_to_a_worker_tells_neither_the_kind_nor_the_folder(
    checked: Checked, tmp_path: Path
) -> None:
    folder = tmp_path / "seed-42-only-control"
    folder.mkdir()
    for part in ("cases", "sealed", "seal.json", "asked.json"):
        (folder / part).symlink_to(checked.folder / part)
    recording = _Recording()
    _diagnosed(CheckFolder(folder), 42, Pool(recording, 2), silent)
    assert len(recording.sent) == 2
    for sent in recording.sent:
        assert b"trial001.csv" in sent
        assert not [kind for kind in ("control", "outside", "only-") if kind.encode() in sent]
        assert str(tmp_path).encode() not in sent


def test_each_kind_has_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    generator = tmp_path / "failing"
    generator.mkdir()
    (generator / "__main__.py").write_text("import sys\nraise SystemExit(' '.join(sys.argv[1:]))\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(LabrunError) as caught:
        check(cases=200, seed=9, only="outside", workers=1, generator=generator)
    assert "--only outside" in str(caught.value)
    assert "--out gap-check/seed-9-only-outside-cases-1-to-200" in str(caught.value)


def test_kinds_are_those_of_the_generator_and_may_be_said_in_the_plural() -> None:
    told = subprocess.run(
        [sys.executable, str(SHIPPED_GENERATOR), "--help"], capture_output=True, text=True, check=True
    )
    (choices,) = {part.partition("}")[0] for part in told.stdout.split("--only {")[1:]}
    assert sorted(choices.replace(" ", "").replace("\n", "").split(",")) == sorted((*KINDS, ROBOT))
    assert [kind_named(f"{kind}s") for kind in KINDS] == list(KINDS)


def test_a_kind_with_a_typo_is_told_the_nearest_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="no kind of case 'contrlo'") as caught:
        check(only="contrlo", out=tmp_path / "out")
    assert 'did you mean "control"?' in str(caught.value.hint)
    assert not (tmp_path / "out").exists()


WORDS = {
    "control": "false alarms in controls",
    "effect": "cause named, alone",
    "pair": "pairs, 1 to 3",
    "parameter": "parameter far off",
    "outside": "recognised, by the true gap",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("failed", [False, True])
def test_what_is_said_of_one_kind_is_silent_about_the_others(kind: str, failed: bool) -> None:
    said = Said.from_json("", {"error": "ValueError: no"}) if failed else None
    found = of_kinds(kind, kind, kind, said=said)
    text = check_text(found)
    assert f"3 cases: 3 {kind}\n" in text
    assert [other for other, words in WORDS.items() if words in text] == [kind]
    assert "\n\n\n" not in text
    assert ("of confidence" in text, "shrinkage" in text) == (False, False)
    page = check_page(found)
    assert len([line for line in page.splitlines() if line.startswith("| 000")]) in (3, 6)
    assert "nan" not in page.lower()
    assert json.dumps(found.to_json(), allow_nan=False)
    if failed and kind != "outside":
        assert "none was diagnosed" in text


def test_an_error_of_confidence_is_told_of_mixed_kinds_only() -> None:
    spoken = Said("", "explained", (Named(LAG, (), 0.9),), Shrunk(0.9, 0.8, 1.0), 1.0)
    mixed, alone = of_kinds("control", "effect", said=spoken), of_kinds("control", "control", said=spoken)
    assert "error of confidence" in check_text(mixed)
    assert "error of confidence" not in check_text(alone)
    assert "shows only where kinds of cases are mixed" in check_page(alone)
    assert "shows only where kinds of cases are mixed" not in check_page(mixed)


def test_a_rate_of_many_cases_is_told_to_a_tenth_of_a_percent() -> None:
    quiet = of_kinds(*["control"] * 200)
    assert "false alarms in controls   0 of 200: 0.0 % [0.0, 1.8]" in check_text(quiet)


def test_what_lies_outside_has_one_share_over_all_that_is_worth_recognising() -> None:
    gaps = (0.2, 0.6, 2.0, 9.0)
    judged = [
        judge(
            Truth(f"case-{number:04d}", "outside", (), gap, "fin-decay", 3, 1, ()),
            Said("", "not-in-library" if gap < 5.0 else "no-gap", (), None, 1.0),
            Shown(None, False),
        )
        for number, gap in enumerate(gaps)
    ]
    found = score(judged)
    assert (found.recognised_from_half.hits, found.recognised_from_half.of) == (2, 3)
    assert found.to_json()["not_in_library"]["recognised_from_0.5"]["of"] == 3
