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

from labrun.blind import Answer, Cause, CauseName, Checked, Scored, check
from labrun.blind.check_folder import CheckFolder, prepare
from labrun.blind.diagnosis_check import _diagnosed, kind_named
from labrun.blind.jobs import fingerprint
from labrun.blind.judging import PredictedShare, Reply, judge
from labrun.blind.robot_check import ROBOT
from labrun.blind.scoring import score
from labrun.blind.truth import KINDS, Truth
from labrun.errors import LabrunError, RequestError
from labrun.report.diagnosis_check import check_page, check_text
from labrun.workers import Pool

TWO_CONTROLS: dict[str, Any] = {"cases": 2, "seed": 42, "first": 4, "only": "control"}
"""A static fin and a payload arm: made within seconds."""
LAG = CauseName(effect="lag", site="torque")
FRICTION = CauseName(effect="coulomb-friction", site="hinge")
NO_GAP = Reply(Answer(gap=False, causes=()), "", 1.0)
CLAIMING = Reply(
    Answer(gap=True, causes=(Cause(effect="lag", site="torque", confidence=0.9),), rest=0.1),
    "",
    1.0,
    PredictedShare(0.9, 0.8, 1.0),
)


def silent(_: str) -> None:
    pass


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> Checked:
    """Two controls, made and scored; in place of their diagnoses stands what is said of them here."""
    out = tmp_path_factory.mktemp("check") / "control-only"
    prepare(CheckFolder(out), **TWO_CONTROLS, workers=2, note=silent)
    for name in ("case-0004", "case-0005"):
        quiet = {
            "verdict": "no-gap",
            "causes": [],
            "rest": None,
            "processor_s": 1.0,
            "programme": fingerprint(),
        }
        CheckFolder(out).keep_reply(name, quiet)
    return check(**TWO_CONTROLS, workers=1, out=out, announce=silent)


def of_kinds(*kinds: str, reply: Reply = NO_GAP, tools: tuple[Reply, ...] = ()) -> Checked:
    """Return a check of hand-made cases of these kinds, all of them answered the same, also by `tools`."""
    hidden = {"effect": (FRICTION,), "pair": (FRICTION, LAG), "parameter": (CauseName(effect="mass"),)}
    truths = [
        Truth(f"case-{number:04d}", kind, hidden.get(kind, ()), 2.0, "hinge-drive", 3, 1, ())
        for number, kind in enumerate(kinds, start=1)
    ]

    def scored(name: str, answered: Reply) -> Scored:
        judged = tuple(judge(truth, answered) for truth in truths)
        return Scored(name, (), judged, score(judged))

    only = kinds[0] if len(set(kinds)) == 1 else None
    others = tuple(scored(f"tool-{number}", tool) for number, tool in enumerate(tools, start=1))
    return Checked(1, only, "0" * 64, Path("gap-check"), ("code",), scored("labrun", reply), others)


def test_all_cases_are_of_that_kind_and_the_folder_remembers_it(checked: Checked) -> None:
    assert [(judged_joint.truth.case, judged_joint.truth.kind) for judged_joint in checked.judged] == [
        ("case-0004", "control"),
        ("case-0005", "control"),
    ]
    assert json.loads((checked.folder / "asked.json").read_text())["only"] == "control"
    loads = json.loads((checked.folder / "check.json").read_text())
    assert (loads["only"], loads["figures"]["kinds"]) == ("control", {"control": 2})
    assert loads["figures"]["controls_blamed"]["of"] == 2


def test_the_same_call_goes_on_where_it_was(checked: Checked) -> None:
    path = checked.folder / "diagnoses" / "case-0004.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "processor_s": 12345.0}))
    again = check(**{**TWO_CONTROLS, "only": "controls"}, workers=1, out=checked.folder, announce=silent)
    assert again.judged[0].reply.processor_s == 12345.0
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
    with pytest.raises(RequestError, match=r"requested is one of 1 cases \(only pair\)"):
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
        future.set_result({"verdict": "no-gap", "causes": [], "processor_s": 0.0})
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
    result = subprocess.run(
        [sys.executable, "-m", "labrun_plugins.cases", "--help"], capture_output=True, text=True, check=True
    )
    (choices,) = {part.partition("}")[0] for part in result.stdout.split("--only {")[1:]}
    assert sorted(choices.replace(" ", "").replace("\n", "").split(",")) == sorted((*KINDS, ROBOT))
    assert [kind_named(f"{kind}s") for kind in KINDS] == list(KINDS)


def test_a_kind_with_a_typo_is_told_the_nearest_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="unknown kind of case 'contrlo'") as caught:
        check(only="contrlo", out=tmp_path / "out")
    assert 'did you mean "control"?' in str(caught.value.hint)
    assert not (tmp_path / "out").exists()


WORDS = {
    "control": "controls blamed",
    "effect": "cause named, G",
    "pair": "both of a pair named",
    "parameter": "parameter far off named",
    "outside": "outside right, G from 0.5",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("failed", [False, True])
def test_what_is_said_of_one_kind_is_silent_about_the_others(kind: str, failed: bool) -> None:
    checked = of_kinds(kind, kind, kind, reply=Reply(None, "ValueError: no") if failed else NO_GAP)
    text = check_text(checked)
    assert f"3 cases: 3 {kind}\n" in text
    expected = [] if failed and kind == "control" else [kind]
    assert [other for other, words in WORDS.items() if words in text] == expected
    assert "\n\n\n" not in text
    assert ("of confidence" in text, "shares in 90" in text) == (False, False)
    page = check_page(checked)
    assert len([line for line in page.splitlines() if line.startswith("| 000")]) in (3, 6)
    assert "nan" not in page.lower()
    assert json.dumps(checked.to_json(), allow_nan=False)
    assert _row("no answer", text) == f"{3 if failed else 0} of 3"


def test_an_error_of_confidence_is_told_of_mixed_kinds_only() -> None:
    mixed, alone = (
        of_kinds("control", "effect", reply=CLAIMING),
        of_kinds("control", "control", reply=CLAIMING),
    )
    assert "error of confidence" in check_text(mixed)
    assert "error of confidence" not in check_text(alone)
    assert "shows only where kinds of cases are mixed" in check_page(alone)
    assert "shows only where kinds of cases are mixed" not in check_page(mixed)


def test_a_rate_of_many_cases_is_told_to_a_tenth_of_a_percent() -> None:
    row = _row("controls blamed", check_text(of_kinds(*["control"] * 200)))
    assert row.startswith("0 of 200: 0.0 % [0.0, 1.8]")


def test_a_tool_stands_beside_labrun_in_every_row_and_on_the_page() -> None:
    checked = of_kinds(
        "control", "effect", reply=NO_GAP, tools=(CLAIMING, Reply(None, "ended with exit code 1"))
    )
    text, page = check_text(checked), check_page(checked)
    assert _row("", text).split() == ["labrun", "tool-1", "tool-2", "to", "reach"]
    assert _row("false causes per case", text).split() == ["0.00", "1.00", "-"]
    assert _row("no answer", text).split() == ["0", "of", "2", "0", "of", "2", "2", "of", "2"]
    assert _row("controls blamed", text).split("  ")[0] == "0 of 1: 0 %"
    assert "## tool-1" in page
    assert page.count("ended with exit code 1") == 2
    assert [tool["name"] for tool in checked.to_json()["tools"]] == ["tool-1", "tool-2"]


def _row(label: str, text: str) -> str:
    (table,) = (block for block in text.split("\n\n") if "to reach" in block)
    lines = [line for line in table.splitlines() if line.startswith(f"{label}  ")]
    return lines[0].removeprefix(label).strip()
