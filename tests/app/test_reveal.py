"""What a diagnosis said beside what was hidden."""

import json
from dataclasses import replace

import gap_examples as examples
import pytest

from labrun.app.diagnose import reveal, store
from labrun.blind import Seal, write_seal
from labrun.errors import RecordingError, RequestError
from labrun.gap.diagnosis import Name, RatedCandidate
from labrun.report.gap_text import compared_text

TRUTH = {
    "effect": "coulomb-friction",
    "site": "hinge",
    "kind": "joint",
    "values": {"torque": 1.5e-4},
    "units": {"torque": "N m"},
}

INERTIA = {
    "effect": "inertia",
    "site": "inertia",
    "kind": "parameter",
    "values": {"inertia": 5.1e-5},
    "units": {"inertia": "kg m^2"},
}


def seal(folder, hidden):
    made = Seal.of(hidden)
    write_seal(folder, made)
    return made


def run_hiding(folder, *hidden, says):
    folder.mkdir()
    sealed = seal(folder, hidden)
    (folder / "spec.toml").write_text("")
    (folder / "provenance.json").write_text(json.dumps({"sealed_sha256": sealed.sha256}))
    store(says, folder / "gap", page=False)
    return folder


@pytest.mark.parametrize(
    ("hidden", "says", "score"),
    [
        ([TRUTH], examples.explained, "right"),
        ([TRUTH], examples.no_gap, "missed"),
        ([TRUTH], examples.parameter, "missed"),
        ([TRUTH], examples.unexplained, "missed"),
        (
            [{**TRUTH, "effect": "backlash", "values": {"gap": 0.002}}],
            examples.no_gap,
            "too small to be seen",
        ),
        ([{**TRUTH, "effect": "backlash", "values": {"gap": 0.004}}], examples.no_gap, "missed"),
        ([TRUTH, {**TRUTH, "effect": "backlash", "values": {"gap": 0.002}}], examples.no_gap, "missed"),
        ([INERTIA], examples.parameter, "right"),
        ([INERTIA], examples.explained, "wrong"),
        ([INERTIA], examples.no_gap, "missed"),
        ([], examples.explained, "false alarm"),
        ([], examples.unexplained, "right"),
        ([], examples.no_gap, "right"),
        ([], examples.parameter, "right"),
        ([{**TRUTH, "effect": "backlash"}], examples.explained, "wrong"),
        ([{**TRUTH, "site": "elbow"}], examples.explained, "wrong"),
        ([TRUTH], examples.pair, "right in part"),
        ([TRUTH, {**TRUTH, "effect": "lag", "site": "torque", "values": {}}], examples.pair, "right"),
        (
            [TRUTH, {**TRUTH, "effect": "delay", "site": "torque", "values": {}}],
            examples.pair,
            "right, in a stated set",
        ),
        ([TRUTH, {**TRUTH, "effect": "drift", "site": "angle"}], examples.explained, "right in part"),
    ],
)
def test_verdict_and_truth_are_compared_by_effect_and_site(tmp_path, hidden, says, score):
    assert reveal(run_hiding(tmp_path / "run", *hidden, says=says())).score == score


def test_a_third_that_explains_the_data_as_well_is_right_in_part(tmp_path):
    as_well = RatedCandidate(Name("backlash", "hinge"), "rival", 0.97)
    says = replace(examples.explained(), candidates=(*examples.explained().candidates, as_well))
    hidden = {**TRUTH, "effect": "backlash", "values": {"gap": 0.004}}
    assert reveal(run_hiding(tmp_path / "run", hidden, says=says)).score == "right in part"


def test_said_and_hidden_stand_under_each_other_in_the_same_units(tmp_path):
    lines = compared_text(reveal(run_hiding(tmp_path / "run", TRUTH, says=examples.explained()))).splitlines()
    assert lines[0].startswith(
        "said      coulomb-friction at hinge: torque = 1.520e-04 [1.440e-04, 1.590e-04] N m"
    )
    assert lines[1] == "hidden    coulomb-friction at hinge: torque = 0.00015 N m"
    assert lines[2] == "score     right"
    assert lines[3] == "sizes     the hidden torque lies inside the 95 % interval that was stated"


def test_a_size_outside_its_interval_is_told(tmp_path):
    far = {**TRUTH, "values": {"torque": 9e-4}}
    assert (
        "torque lies outside" in reveal(run_hiding(tmp_path / "run", far, says=examples.explained())).sizes[0]
    )


def test_without_a_diagnosis_the_seal_stays_closed(tmp_path):
    folder = run_hiding(tmp_path / "run", TRUTH, says=examples.explained())
    (folder / "gap" / "diagnosis.json").unlink()
    with pytest.raises(RequestError, match="no diagnosis yet"):
        reveal(folder)
    assert json.loads((folder / "seal.json").read_text())["opened_at"] == []


def test_a_seal_that_was_changed_is_not_believed(tmp_path):
    folder = run_hiding(tmp_path / "run", TRUTH, says=examples.explained())
    seal(folder, [])
    with pytest.raises(RecordingError, match="not the seal that the run began with"):
        reveal(folder)


def test_a_script_gets_score_and_truth(tmp_path):
    results = reveal(run_hiding(tmp_path / "run", TRUTH, says=examples.pair())).to_json()
    assert results["score"] == "right in part"
    assert results["hidden"][0]["values"] == {"torque": 1.5e-4}
    assert results["verdict"] == "partly-explained"
