"""Joints that an earlier run had diagnosed are taken from it, and only for the same question."""

import json
from dataclasses import replace

import numpy as np
import pytest

from labrun.app.joints_done import JointsDone
from labrun.effects import load_effect
from labrun.gap.diagnosis import Cause, ComparedTrace, Diagnosis, Name, ResampledNumber, Rest, Rung, Sizes


@pytest.fixture
def answer():
    friction = load_effect("coulomb-friction", "joint").attach("elbow", torque=0.2)
    size = ResampledNumber(0.2, 0.1, 0.3, "N m")
    cause = Cause(Name("coulomb-friction", "elbow"), 0.9, {"torque": size}, 0.8, 0.7, ())
    course = np.linspace(0.0, 1.0, 3)
    trace = ComparedTrace("1", {"motion": "m"}, 1, course, np.empty((3, 0)), *[course[:, None]] * 4)
    return Diagnosis(
        name="arm: elbow", model="arm-elbow", source="recordings/arm", verdict="explained", sentence="Friction.",
        gap=Sizes(9.0, 5.0, 0.5, 1.0), where=(), causes=(cause,), differs=(), candidates=(), shrinkage=None,
        recalibration={"elbow_kp": (40.0, "free", 41.0)}, corrected={"elbow_kp": 41.0}, effects=(friction,),
        limitations=("no repeats",), notes=(), what_next=(), channels=(("elbow", "rad"),), input_channels=(),
        noise={"elbow": 1e-3}, trials=3, conditions=3, repeats=1, missing=(), traces=(trace,), parameter_units={},
        seed=0, seconds=1.0, ladder=(Rung("as stated", None, {"elbow": float("nan")}, 9.0, 0.0),), rest=Rest(0.5, 0.1),
    )  # fmt: skip


def test_an_answer_is_resumed_with_its_causes_effects_and_traces(tmp_path, answer):
    JointsDone(tmp_path / "arm" / "gap-1").keep("question", answer)
    resumed = JointsDone(tmp_path / "arm-2" / "gap-2").get("question")
    assert resumed.causes == answer.causes
    assert resumed.effects == answer.effects
    assert resumed.recalibration == answer.recalibration
    np.testing.assert_array_equal(resumed.traces[0].after, answer.traces[0].after)
    assert resumed.traces[0].inputs.shape == (3, 0)
    assert np.isnan(resumed.ladder[0].errors["elbow"])
    plain = [json.dumps(each.to_json(), sort_keys=True) for each in (resumed, answer)]
    assert plain[0] == plain[1]


def test_another_question_and_a_file_of_something_else_resume_nothing(tmp_path, answer):
    first = JointsDone(tmp_path / "arm" / "gap-1")
    first.keep("question", answer)
    (tmp_path / "arm" / "gap-0-joints.json").write_text('{"other": {"type": "Popen", "of": {}}}')
    (tmp_path / "arm" / "gap-3-joints.json").write_text("cut o")
    second = JointsDone(tmp_path / "arm" / "gap-2")
    assert second.get("another") is None
    assert second.get("other") is None


def test_files_go_once_the_whole_robot_is_diagnosed(tmp_path, answer):
    JointsDone(tmp_path / "arm" / "gap-1").keep("elbow", answer)
    second = JointsDone(tmp_path / "arm" / "gap-2")
    assert second.get("elbow") is not None
    second.keep("shoulder", replace(answer, name="arm: shoulder"))
    second.discard()
    assert list(tmp_path.rglob("*-joints.json")) == []
