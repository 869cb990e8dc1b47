"""What is read from a diagnosis of labrun, and from another program."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from labrun.blind import Answer, CauseName
from labrun.blind.answer import reason_of

FRICTION = {"kind": "effect", "effect": "coulomb-friction", "site": "hinge"}
LAG = {"kind": "effect", "effect": "lag", "site": "torque"}
CLAIMING = ("explained", "mostly-explained", "partly-explained")


def cause(
    name: dict[str, str] = FRICTION, closes: float = 0.8, rivals: tuple[Any, ...] = ()
) -> dict[str, Any]:
    return {
        **name,
        "values": {"torque": {"value": 0.2, "ci95": [0.1, 0.3], "unit": "N m"}},
        "confidence": 0.9,
        "closes": closes,
        "indistinguishable_from": list(rivals),
        "rivals": [],
    }


def diagnosis(verdict: str, *causes: dict[str, Any], rest: Any = None) -> dict[str, Any]:
    """Return what a diagnosis prints."""
    return {"verdict": verdict, "causes": list(causes), "ladder": [], "rest": rest}


@given(st.sampled_from(CLAIMING), st.floats(0.0, 1.0))
def test_what_is_announced_is_claimed_however_little_it_closes(verdict: str, closes: float) -> None:
    assert len(Answer.of_diagnosis(diagnosis(verdict, cause(closes=closes))).causes) == 1


@given(st.sampled_from(["unexplained", "no-gap", "cannot-tell"]), st.floats(0.0, 1.0))
def test_what_closes_half_of_the_gap_is_claimed_whatever_the_verdict(verdict: str, closes: float) -> None:
    claimed = Answer.of_diagnosis(diagnosis(verdict, cause(closes=closes))).causes
    assert len(claimed) == (closes >= 0.5)


def test_the_rest_is_the_share_that_is_told_and_nothing_within_the_noise() -> None:
    message = Answer.of_diagnosis(
        diagnosis("mostly-explained", cause(), rest={"within_noise": False, "share_of_gap": 0.23})
    )
    assert (message.rest, message.tells_rest) == (0.23, True)
    noise = Answer.of_diagnosis(
        diagnosis("explained", cause(), rest={"within_noise": True, "share_of_gap": 0.3})
    )
    assert not noise.tells_rest
    small = Answer.of_diagnosis(
        diagnosis("explained", cause(), rest={"within_noise": False, "share_of_gap": 0.05})
    )
    assert not small.tells_rest
    assert (
        Answer.of_diagnosis(diagnosis("unexplained", rest={"within_noise": False, "share_of_gap": 1.7})).rest
        == 1.0
    )


def test_a_gap_is_reported_unless_there_is_none_or_it_cannot_be_told() -> None:
    verdicts = (*CLAIMING, "unexplained", "no-gap", "cannot-tell")
    reported = [verdict for verdict in verdicts if Answer.of_diagnosis(diagnosis(verdict)).gap]
    assert reported == [*CLAIMING, "unexplained"]


def test_size_rivals_and_confidence_are_kept_and_a_parameter_has_no_site() -> None:
    mass = {"kind": "parameter", "effect": "mass", "site": "mass"}
    (claimed,) = Answer.of_diagnosis(diagnosis("explained", cause(rivals=(LAG, mass)))).causes
    assert claimed.size["torque"].ci95 == (0.1, 0.3)
    assert [str(member) for member in claimed.members] == [
        "coulomb-friction at hinge", "lag at torque", "parameter mass",
    ]  # fmt: skip
    assert claimed.confidence == 0.9


def test_three_fields_are_an_answer_and_more_of_them_are_left_alone() -> None:
    text = '{"gap": true, "causes": [{"effect": "lag", "site": "torque"}], "rest": 0.2, "version": 3}'
    answer = Answer.model_validate_json(text)
    assert answer.causes[0].name == CauseName(effect="lag", site="torque")
    assert not answer.causes[0].closes_half


@pytest.mark.parametrize(
    ("printed", "words"),
    [
        ({}, "gap: field required; causes: field required"),
        ({"gap": "yes", "causes": []}, "gap: input should be a valid boolean"),
        ({"gap": True, "causes": [{"site": "hinge"}]}, "causes.0.effect: field required"),
        ({"gap": True, "causes": [{"effect": "lag", "closse": 0.5}]}, "causes.0.closse"),
        ({"gap": True, "causes": [], "rest": 40}, "rest: input should be less than or equal to 1"),
    ],
)
def test_what_is_no_answer_is_told_field_by_field(printed: Any, words: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Answer.model_validate(json.loads(json.dumps(printed)))
    assert words in reason_of(caught.value)
