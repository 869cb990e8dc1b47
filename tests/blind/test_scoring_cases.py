"""Scores of hand-made answers."""

import pytest

from labrun.blind import Answer, Cause, CauseName, Judged
from labrun.blind.judging import PredictedShare, Reply, Shown, judge, sizes_held
from labrun.blind.scoring import score
from labrun.blind.truth import Truth

COULOMB = CauseName(effect="coulomb-friction", site="hinge")
STRIBECK = CauseName(effect="stribeck-friction", site="hinge")
HYSTERESIS = CauseName(effect="hysteresis", site="hinge")
ELSEWHERE = CauseName(effect="coulomb-friction", site="elbow")
LAG = CauseName(effect="lag", site="torque")
MASS = CauseName(effect="mass")


def truth(kind: str, *causes: CauseName, gap: float = 5.0, case: str = "case-0001") -> Truth:
    return Truth(case, kind, causes, gap, "hinge-drive", 3, 1, ())


def claim(
    *members: CauseName,
    closes: float | None = 0.9,
    confidence: float | None = None,
    **size: tuple[float, float],
) -> Cause:
    sizes = {name: {"value": sum(ends) / 2, "ci95": ends} for name, ends in size.items()}
    return Cause.model_validate(
        {
            **members[0].model_dump(),
            "rivals": [member.model_dump() for member in members[1:]],
            "closes": closes,
            "confidence": confidence,
            "size": sizes,
        }
    )


def reply(
    *causes: Cause, gap: bool = True, rest: float | None = None, predicted: PredictedShare | None = None
) -> Reply:
    return Reply(Answer(gap=gap, causes=causes, rest=rest), "", 1.0, predicted)


NO_GAP = reply(gap=False)
FAILED = Reply(None, "not finished within 5 s", 5.0)


def outcome(true: Truth, answered: Reply) -> str:
    return judge(true, answered).outcome


def test_a_cause_that_is_held_alone_or_with_one_rival_is_named() -> None:
    true = truth("effect", COULOMB)
    assert outcome(true, reply(claim(COULOMB))) == "named"
    assert outcome(true, reply(claim(STRIBECK, COULOMB))) == "named"
    assert outcome(true, reply(claim(LAG), claim(COULOMB, STRIBECK))) == "named"


def test_a_set_of_three_names_nothing_but_is_no_false_cause() -> None:
    judged = judge(truth("effect", COULOMB), reply(claim(COULOMB, STRIBECK, HYSTERESIS)))
    assert (judged.outcome, judged.named, judged.false_causes) == ("set-too-large", 0, 0)


def test_the_leading_cause_repeated_among_its_rivals_does_not_enlarge_the_set() -> None:
    assert outcome(truth("effect", COULOMB), reply(claim(COULOMB, COULOMB, STRIBECK))) == "named"


def test_the_right_effect_at_another_site_is_not_named_and_is_a_false_cause() -> None:
    judged = judge(truth("effect", COULOMB), reply(claim(ELSEWHERE)))
    assert (judged.outcome, judged.effects, judged.named, judged.false_causes) == ("wrong-site", 1, 0, 1)
    assert outcome(truth("effect", COULOMB), reply(claim(ELSEWHERE, COULOMB))) == "named"


def test_a_second_claim_of_the_same_cause_is_a_false_cause() -> None:
    judged = judge(truth("effect", COULOMB), reply(claim(COULOMB), claim(STRIBECK, COULOMB)))
    assert (judged.outcome, judged.false_causes, judged.right) == ("named", 1, False)


def test_without_a_claim_a_gap_or_nothing_was_said() -> None:
    true = truth("effect", COULOMB)
    assert outcome(true, reply(rest=1.0)) == "gap-without-cause"
    assert outcome(true, NO_GAP) == "nothing-said"
    assert outcome(true, reply(claim(LAG))) == "wrong-cause"


def test_a_parameter_is_no_effect_of_the_same_name() -> None:
    true = truth("parameter", MASS)
    assert outcome(true, reply(claim(MASS))) == "named"
    assert outcome(true, reply(claim(CauseName(effect="mass", site="hinge")))) == "wrong-cause"


def test_of_a_pair_each_cause_needs_a_set_of_its_own() -> None:
    true = truth("pair", COULOMB, LAG)
    assert outcome(true, reply(claim(LAG), claim(STRIBECK, COULOMB))) == "both-named"
    assert outcome(true, reply(claim(LAG, COULOMB))) == "one-named"
    assert outcome(true, reply(claim(HYSTERESIS, STRIBECK, LAG), claim(COULOMB))) == "one-named"
    assert outcome(true, reply(claim(ELSEWHERE), claim(LAG))) == "one-named"
    assert outcome(true, NO_GAP) == "none-named"


def test_claims_are_matched_to_a_pair_as_well_as_they_can_be() -> None:
    judged = judge(
        truth("pair", COULOMB, LAG), reply(claim(COULOMB, LAG), claim(COULOMB, STRIBECK), claim(ELSEWHERE))
    )
    assert (judged.outcome, judged.effects, judged.false_causes) == ("both-named", 2, 1)


def test_in_a_control_nothing_may_be_claimed_neither_effect_nor_parameter() -> None:
    true = truth("control", gap=0.0)
    assert outcome(true, NO_GAP) == "quiet"
    assert outcome(true, reply()) == "gap-reported"
    assert outcome(true, reply(claim(COULOMB))) == "false-alarm"
    assert outcome(true, reply(claim(MASS))) == "false-alarm"


@pytest.mark.parametrize(
    ("answered", "wanted", "false_causes"),
    [
        (reply(rest=0.8), "rest-told", 0),
        (reply(claim(LAG, closes=0.2), rest=0.8), "rest-told", 0),
        (reply(claim(LAG, closes=0.6), rest=0.4), "rest-told", 0),
        (reply(claim(LAG, closes=0.95), rest=0.05), "not-blamed", 0),
        (NO_GAP, "not-blamed", 0),
        (reply(claim(LAG, closes=0.6), claim(COULOMB, closes=0.4), rest=0.0), "blamed", 1),
        (reply(claim(LAG, closes=0.4)), "blamed", 1),
        (reply(claim(LAG, closes=None)), "blamed", 1),
    ],
)
def test_outside_of_the_library_a_claim_closes_half_of_the_gap_or_the_rest_is_told(
    answered: Reply, wanted: str, false_causes: int
) -> None:
    judged = judge(truth("outside"), answered)
    assert (judged.outcome, judged.false_causes) == (wanted, false_causes)
    assert judged.right == (wanted != "blamed")


def test_a_program_without_an_answer_names_nothing_and_makes_no_rate_look_better() -> None:
    cases = [
        judge(truth("control", case="case-0001"), FAILED),
        judge(truth("control", case="case-0002"), reply(claim(LAG))),
        judge(truth("effect", LAG, case="case-0003"), FAILED),
        judge(truth("outside", case="case-0004"), FAILED),
    ]
    scores = score(cases)
    assert [case.outcome for case in cases] == ["no-answer", "false-alarm", "no-answer", "no-answer"]
    assert (scores.controls_blamed.hits, scores.controls_blamed.of) == (1, 1)
    assert (scores.named["3 and above"].hits, scores.named["3 and above"].of) == (0, 1)
    assert (scores.outside_from_half.hits, scores.outside_from_half.of) == (0, 1)
    assert scores.false_causes_per_case == 1.0
    assert scores.unanswered["case-0003"] == "not finished within 5 s"
    assert scores.processor_s["longest"] == 1.0


def test_more_trials_than_are_drawn_are_a_kind_of_data_of_their_own() -> None:
    few, many = (
        Truth("case-0001", "control", (), 0.0, "hinge-drive", 2, 1, (), conditions=conditions)
        for conditions in (25, 26)
    )
    assert few.data == ("2 repeats",)
    assert many.data == ("2 repeats", "many trials")


def test_strengths_begin_at_their_lower_bound() -> None:
    classes = [truth("effect", LAG, gap=gap).strength for gap in (0.0, 0.499, 0.5, 1.0, 2.99, 3.0, 30.0)]
    assert classes == ["below 0.5"] * 2 + ["0.5 to 1"] + ["1 to 3"] * 2 + ["3 and above"] * 2


def test_shares_are_counted_by_the_true_strength() -> None:
    scores = score(
        [
            judge(truth("effect", COULOMB, gap=0.7), reply(claim(COULOMB))),
            judge(truth("effect", COULOMB, gap=0.7), NO_GAP),
            judge(truth("effect", COULOMB, gap=2.0), reply(claim(ELSEWHERE))),
            judge(truth("pair", COULOMB, LAG, gap=2.0), reply(claim(LAG))),
            judge(truth("outside", gap=2.0), reply(rest=1.0)),
            judge(truth("outside", gap=0.6), NO_GAP),
            judge(truth("outside", gap=0.1), reply(claim(LAG, closes=0.1))),
            judge(truth("control", gap=0.0), reply(rest=1.0)),
        ]
    )
    assert (scores.named["0.5 to 1"].hits, scores.named["0.5 to 1"].of) == (1, 2)
    assert (scores.named["1 to 3"].hits, scores.named["1 to 3"].of) == (0, 1)
    assert (scores.sites.hits, scores.sites.of) == (2, 3)
    assert (scores.pairs["1 to 3"].hits, scores.pairs["1 to 3"].of, scores.pairs_in_part) == (0, 1, 1)
    assert [scores.outside[name].hits for name in ("1 to 3", "0.5 to 1", "below 0.5")] == [1, 1, 0]
    assert (scores.rest_told.hits, scores.rest_told.of) == (1, 2)
    assert (scores.controls_with_gap.hits, scores.controls_blamed.hits) == (1, 0)
    assert scores.false_causes_per_case == 2 / 8


def test_confidence_is_held_against_the_cause_or_its_first_rival_and_the_site() -> None:
    true = truth("effect", COULOMB)
    scores = score(
        [
            judge(true, reply(claim(COULOMB, confidence=0.95))),
            judge(true, reply(claim(ELSEWHERE, LAG, COULOMB, confidence=0.95))),
            judge(true, reply(claim(COULOMB))),
            judge(truth("control"), reply(claim(LAG, confidence=0.15))),
        ]
    )
    low, high = scores.calibration.bins
    assert (low.right.hits, low.right.of, high.right.hits, high.right.of) == (0, 1, 1, 2)
    assert scores.calibration.error == pytest.approx((1 * 0.15 + 2 * 0.45) / 3)
    assert scores.set_sizes == {1: 3, 3: 1}


def test_predicted_shares_are_compared_where_the_fresh_gap_is_large_enough() -> None:
    def case(name: str, shown: Shown) -> Judged:
        return judge(
            truth("effect", LAG, case=name), reply(claim(LAG), predicted=PredictedShare(0.9, 0.8, 1.0)), shown
        )

    scores = score(
        [
            case("a", Shown(0.85, True)),
            case("b", Shown(0.7, True)),
            case("c", Shown(0.99, True)),
            case("d", Shown(-7.0, False)),
            case("e", Shown(None, False, "FitError: diverges")),
            judge(truth("effect", LAG), reply(claim(LAG)), Shown(0.9, True)),
            judge(truth("effect", LAG), NO_GAP),
        ]
    ).shares
    assert scores.differences == pytest.approx({"a": 0.05, "b": 0.2, "c": -0.09})
    assert scores.median_difference == pytest.approx(0.09)
    assert (scores.covered.hits, scores.covered.of) == (2, 3)
    assert (scores.too_small, scores.failed, scores.unpredicted) == (1, 1, 1)


def test_scores_of_nothing_say_so() -> None:
    scores = score([]).to_json()
    assert scores["controls_blamed"] == {"share": None, "hits": 0, "of": 0, "ci95": None}
    assert scores["calibration"]["expected_calibration_error"] is None
    assert scores["shares"]["median_difference"] is None
    assert scores["false_causes_per_case"] is None


def test_the_size_of_a_true_cause_is_held_against_the_one_that_was_simulated() -> None:
    true = Truth("case-0001", "effect", (COULOMB,), 5.0, "", 3, 1, (), sizes=({"torque": 0.5, "edge": 1.0},))

    def held(name: CauseName, **size: tuple[float, float]) -> list[bool]:
        return sizes_held(judge(true, reply(claim(name, **size))))

    assert held(COULOMB, torque=(0.4, 0.6)) == [True]
    assert held(COULOMB, torque=(0.51, 0.6)) == [False]
    assert held(COULOMB) == []
    assert held(STRIBECK, torque=(0.4, 0.6)) == []
    assert score([judge(true, NO_GAP)]).sizes_covered.value is None


def test_a_confidence_that_is_no_probability_is_no_answer() -> None:
    printed = {
        "verdict": "explained",
        "ladder": [],
        "rest": None,
        "causes": [{"effect": "lag", "site": "torque", "indistinguishable_from": [], "confidence": 1.2}],
    }
    read = Reply.of_labrun(printed)
    assert read.answer is None
    assert "confidence: input should be less than or equal to 1" in read.reason
