"""Scores of hand-made answers."""

from dataclasses import asdict
from typing import Any

from labrun.blind.judging import CauseName, Judged, Named, Said, Shown, Shrunk, Truth, judge, sizes_held
from labrun.blind.scoring import confusion, score

COULOMB = CauseName("effect", "coulomb-friction", "hinge")
STRIBECK = CauseName("effect", "stribeck-friction", "hinge")
HYSTERESIS = CauseName("effect", "hysteresis", "hinge")
ELSEWHERE = CauseName("effect", "coulomb-friction", "elbow")
LAG = CauseName("effect", "lag", "torque")
MASS = CauseName("parameter", "mass")


def truth(kind: str, *causes: CauseName, gap: float = 5.0, case: str = "case-0001") -> Truth:
    return Truth(case, kind, causes, gap, "hinge-drive", 3, 1, ())


def named(*members: CauseName, confidence: float = 0.9) -> Named:
    return Named(members[0], members[1:], confidence)


def said(
    verdict: str,
    *causes: Named,
    shrinkage: Shrunk | None = None,
    seconds: float = 1.0,
    case: str = "case-0001",
) -> Said:
    return Said(case, verdict, causes, shrinkage, seconds)


def outcome(true: Truth, spoken: Said) -> str:
    return judge(true, spoken).outcome


def test_a_cause_that_is_named_alone_or_with_one_rival_is_named() -> None:
    true = truth("effect", COULOMB)
    assert outcome(true, said("explained", named(COULOMB))) == "named"
    assert outcome(true, said("explained", named(STRIBECK, COULOMB))) == "named"
    assert outcome(true, said("partly-explained", named(COULOMB, STRIBECK))) == "named"


def test_more_trials_than_are_drawn_are_a_kind_of_data_of_their_own() -> None:
    few, many = (
        Truth("case-0001", "control", (), 0.0, "hinge-drive", 2, 1, (), conditions=conditions)
        for conditions in (25, 26)
    )
    assert few.data == ("2 repeats",)
    assert many.data == ("2 repeats", "many trials")


def test_a_set_of_three_names_nothing() -> None:
    true = truth("effect", COULOMB)
    assert outcome(true, said("explained", named(COULOMB, STRIBECK, HYSTERESIS))) == "set-too-large"


def test_the_top_cause_repeated_among_its_rivals_does_not_enlarge_the_set() -> None:
    true = truth("effect", COULOMB)
    assert outcome(true, said("explained", named(COULOMB, COULOMB, STRIBECK))) == "named"


def test_the_right_effect_at_another_site_is_named_with_a_wrong_site() -> None:
    judged = judge(truth("effect", COULOMB), said("explained", named(ELSEWHERE)))
    assert (judged.outcome, judged.found, judged.sites) == ("wrong-site", 1, 0)


def test_a_set_of_two_sites_that_holds_the_true_one_is_right() -> None:
    assert outcome(truth("effect", COULOMB), said("explained", named(ELSEWHERE, COULOMB))) == "named"


def test_a_cause_that_comes_second_is_not_named() -> None:
    judged = judge(truth("effect", COULOMB), said("explained", named(LAG), named(COULOMB)))
    assert (judged.outcome, judged.found, judged.extra) == ("not-first", 0, 1)


def test_causes_of_a_verdict_that_blames_nothing_do_not_count() -> None:
    true = truth("effect", COULOMB)
    assert outcome(true, said("not-in-library", named(COULOMB))) == "said-unknown"
    assert outcome(true, said("no-gap")) == "nothing-said"
    assert outcome(true, said("explained", named(LAG))) == "wrong-cause"


def test_a_parameter_is_named_whatever_site_it_is_given() -> None:
    true = truth("parameter", MASS)
    assert outcome(true, said("parameter", named(CauseName("parameter", "mass", "model")))) == "named"
    assert outcome(true, said("parameter")) == "nothing-said"
    assert outcome(true, said("explained", named(CauseName("effect", "mass", "")))) == "wrong-cause"


def test_of_a_pair_each_cause_needs_a_set_of_its_own() -> None:
    true = truth("pair", COULOMB, LAG)
    assert outcome(true, said("explained", named(LAG), named(STRIBECK, COULOMB))) == "both-named"
    assert outcome(true, said("explained", named(LAG, COULOMB))) == "one-named"
    assert outcome(true, said("explained", named(HYSTERESIS), named(LAG))) == "one-named"
    assert outcome(true, said("explained", named(HYSTERESIS, STRIBECK, LAG))) == "none-named"
    assert outcome(true, said("no-gap")) == "none-named"


def test_sites_of_a_pair_are_matched_as_well_as_they_can_be() -> None:
    true = truth("pair", COULOMB, LAG)
    judged = judge(true, said("explained", named(ELSEWHERE), named(LAG), named(COULOMB)))
    assert (judged.found, judged.sites, judged.extra) == (2, 2, 1)


def test_a_control_is_a_false_alarm_only_where_an_effect_is_blamed() -> None:
    true = truth("control", gap=0.0)
    assert outcome(true, said("no-gap")) == "quiet"
    assert outcome(true, said("parameter")) == "quiet"
    assert outcome(true, said("parameter", named(MASS))) == "quiet"
    assert outcome(true, said("not-in-library", named(COULOMB))) == "said-unknown"
    assert outcome(true, said("explained", named(MASS))) == "quiet"
    assert outcome(true, said("explained", named(COULOMB))) == "false-alarm"
    assert outcome(true, said("partly-explained", named(MASS), named(COULOMB))) == "false-alarm"
    assert outcome(true, said("parameter", named(MASS), named(COULOMB))) == "false-alarm"


def test_a_control_that_is_called_unknown_went_wrong_but_is_no_false_alarm() -> None:
    judged = judge(truth("control"), said("not-in-library"))
    found = score([judged])
    assert not judged.good
    assert (found.false_alarms.hits, found.wrongly_unknown.hits) == (0, 1)


def test_a_named_cause_with_another_beside_it_went_wrong() -> None:
    assert judge(truth("effect", COULOMB), said("explained", named(COULOMB))).good
    assert not judge(truth("effect", COULOMB), said("explained", named(COULOMB), named(LAG))).good
    assert judge(truth("effect", COULOMB), said("explained", named(COULOMB), named(MASS))).good


def test_what_is_outside_of_the_library_is_recognised_by_its_verdict_alone() -> None:
    true = truth("outside")
    assert outcome(true, said("not-in-library", named(COULOMB))) == "recognised"
    assert outcome(true, said("partly-explained", named(COULOMB))) == "blamed"
    assert outcome(true, said("no-gap")) == "nothing-said"


def test_a_case_that_raised_counts_as_one_that_was_not_named() -> None:
    failed = Said.from_json("case-0002", {"error": "ValueError: no", "seconds": 3.0})
    found = score([judge(truth("effect", COULOMB), said("explained", named(COULOMB))), _failed(failed)])
    assert found.errors == ["case-0002"]
    assert (found.named["3 and above"].hits, found.named["3 and above"].of) == (1, 2)
    assert found.seconds["longest"] == 1.0


def test_a_confidence_that_is_no_probability_is_an_error_of_its_case() -> None:
    cause = {"kind": "effect", "effect": "lag", "site": "torque", "indistinguishable_from": []}
    told = {"verdict": "explained", "seconds": 1.0, "shrinkage": None}
    for confidence in (None, 1.2):
        spoken = Said.from_json("case-0001", {**told, "causes": [{**cause, "confidence": confidence}]})
        assert judge(truth("effect", LAG), spoken).outcome == "error"
    spoken = Said.from_json("case-0001", {**told, "causes": [{**cause, "confidence": 0.5}]})
    assert outcome(truth("effect", LAG), spoken) == "named"


def test_a_set_is_as_large_as_the_table_of_candidates_tells() -> None:
    def told(cause: CauseName, *alike: CauseName) -> dict[str, Any]:
        return {**asdict(cause), "confidence": 0.6, "indistinguishable_from": [asdict(one) for one in alike]}

    rivals = [{**told(one, LAG), "verdict": "indistinguishable"} for one in (COULOMB, ELSEWHERE)]
    spoken = {"verdict": "explained", "seconds": 1.0, "causes": [told(LAG, COULOMB)], "candidates": rivals}
    assert outcome(truth("effect", LAG), Said.from_json("case-0001", spoken)) == "set-too-large"
    spoken["candidates"] = rivals[:1]
    assert outcome(truth("effect", LAG), Said.from_json("case-0001", spoken)) == "named"


def test_a_control_that_raised_does_not_make_false_alarms_rarer() -> None:
    failed = Said.from_json("case-0002", {"error": "ValueError: no"})
    alarm = said("explained", named(LAG))
    found = score([judge(truth("control"), failed), judge(truth("control"), alarm)])
    assert (found.false_alarms.hits, found.false_alarms.of, found.wrongly_unknown.of) == (1, 1, 1)


def _failed(failed: Said) -> Judged:
    return judge(truth("effect", LAG, case="case-0002"), failed)


def test_strengths_begin_at_their_lower_bound() -> None:
    classes = [truth("effect", LAG, gap=gap).strength for gap in (0.0, 0.499, 0.5, 1.0, 2.99, 3.0, 30.0)]
    assert classes == ["below 0.5"] * 2 + ["0.5 to 1"] + ["1 to 3"] * 2 + ["3 and above"] * 2


def test_shares_are_counted_by_the_true_strength() -> None:
    found = score(
        [
            judge(truth("effect", COULOMB, gap=0.7), said("explained", named(COULOMB))),
            judge(truth("effect", COULOMB, gap=0.7), said("no-gap")),
            judge(truth("effect", COULOMB, gap=2.0), said("explained", named(ELSEWHERE))),
            judge(truth("outside", gap=2.0), said("not-in-library")),
            judge(truth("outside", gap=0.1), said("no-gap")),
            judge(truth("control", gap=0.0), said("not-in-library")),
        ]
    )
    assert (found.named["0.5 to 1"].hits, found.named["0.5 to 1"].of) == (1, 2)
    assert (found.named["1 to 3"].hits, found.named["1 to 3"].of) == (1, 1)
    assert found.named["below 0.5"].of == 0
    assert (found.sites.hits, found.sites.of) == (1, 2)
    assert (found.recognised["1 to 3"].hits, found.recognised["below 0.5"].hits) == (1, 0)
    assert (found.wrongly_unknown.hits, found.wrongly_unknown.of) == (1, 4)
    assert (found.false_alarms.hits, found.false_alarms.of) == (0, 1)


def test_the_confusion_tells_what_was_said_of_what() -> None:
    table = confusion(
        [
            judge(truth("effect", COULOMB), said("explained", named(STRIBECK))),
            judge(truth("effect", COULOMB), said("explained", named(STRIBECK))),
            judge(truth("effect", COULOMB), said("not-in-library")),
            judge(truth("pair", LAG, COULOMB), said("explained", named(COULOMB), named(MASS))),
            judge(truth("control"), said("parameter")),
        ]
    )
    assert table == {
        "(control)": {"(parameter, no cause)": 1},
        "coulomb-friction": {"(not-in-library)": 1, "stribeck-friction": 2},
        "coulomb-friction + lag": {"(parameter) + coulomb-friction": 1},
    }


def test_confidence_is_held_against_the_cause_or_its_first_rival_and_the_site() -> None:
    found = score(
        [
            judge(truth("effect", COULOMB), said("explained", named(COULOMB, confidence=0.95))),
            judge(
                truth("effect", COULOMB), said("explained", named(ELSEWHERE, LAG, COULOMB, confidence=0.95))
            ),
            judge(truth("control"), said("explained", named(LAG, confidence=0.15))),
        ]
    )
    low, high = found.calibration.bins
    assert (low.right.hits, low.right.of, high.right.hits, high.right.of) == (0, 1, 1, 2)
    assert abs((found.calibration.error or 0.0) - (1 * 0.15 + 2 * 0.45) / 3) < 1e-12
    assert found.set_sizes == {1: 2, 3: 1}


def test_shrinkage_is_compared_where_the_fresh_gap_is_large_enough() -> None:
    def case(name: str, low: float, shown: Shown) -> Judged:
        spoken = said("explained", named(LAG), shrinkage=Shrunk(0.9, low, 1.0), case=name)
        return judge(truth("effect", LAG, case=name), spoken, shown)

    found = score(
        [
            case("a", 0.8, Shown(0.85, True)),
            case("b", 0.8, Shown(0.7, True)),
            case("c", 0.8, Shown(0.99, True)),
            case("d", 0.8, Shown(-7.0, False)),
            case("e", 0.8, Shown(None, False, "FitError: blew up")),
            judge(truth("effect", LAG), said("explained", named(LAG)), Shown(0.9, True)),
            judge(truth("effect", LAG), said("no-gap")),
        ]
    ).shrinkage
    assert {name: round(value, 9) for name, value in found.differences.items()} == {
        "a": 0.05,
        "b": 0.2,
        "c": -0.09,
    }
    assert abs((found.median_difference or 0.0) - 0.09) < 1e-12
    assert (found.covered.hits, found.covered.of) == (2, 3)
    assert (found.too_small, found.failed, found.unpredicted) == (1, 1, 1)


def test_scores_of_nothing_say_so() -> None:
    found = score([]).to_json()
    assert found["false_alarms"] == {"share": None, "hits": 0, "of": 0, "ci95": None}
    assert found["calibration"]["expected_calibration_error"] is None
    assert found["shrinkage"]["median_difference"] is None


def test_the_size_of_a_true_cause_is_held_against_the_one_that_was_simulated() -> None:
    true = Truth("case-0001", "effect", (COULOMB,), 5.0, "", 3, 1, (), sizes=({"torque": 0.5, "edge": 1.0},))

    def held(cause: CauseName, low: float, high: float) -> list[bool]:
        spoken = said("explained", Named(cause, (), 0.9, {"torque": (low, high)}))
        return sizes_held(judge(true, spoken))

    assert held(COULOMB, 0.4, 0.6) == [True]
    assert held(COULOMB, 0.51, 0.6) == [False]
    assert held(STRIBECK, 0.4, 0.6) == []
    assert score([judge(true, said("no-gap"))]).sizes_covered.value is None
