"""From sizes and shares to a verdict."""

from dataclasses import replace

import pytest
from labrun.gap.verdict import VerdictBasis, may_help_nothing, stands_all_the_same, verdict

from labrun.gap.diagnosis import BeyondScatter, Shrinkage, Sizes


def findings(
    *, sizes=(5.0, 4.0, 0.2, 0.3), share=(0.98, 0.9, 1.0), effects=1, parameters=0, remains=False, **more
):
    return VerdictBasis(
        Sizes(*sizes),
        remains,
        more.get("repeated", True),
        effects,
        parameters,
        None if share is None else Shrinkage(*share),
        BeyondScatter(more.get("learnable", 0.0), more.get("size", 2.0), more.get("chance_of_lines", 1.0)),
        more.get("trials", 5),
    )


def nothing_found(*, sizes, remains=True, **more):
    return findings(sizes=sizes, share=None, effects=0, remains=remains, **more)


def test_a_cause_that_leaves_nothing_explains_the_gap():
    assert verdict(findings()) == "explained"


def test_a_cause_that_leaves_much_explains_it_in_part():
    found = findings(sizes=(5.0, 4.0, 0.4, 0.3), share=(0.8, 0.7, 1.0), remains=True)
    assert verdict(found) == "partly-explained"


def test_what_removes_too_little_to_be_the_cause_is_not_taken_for_one():
    found = findings(sizes=(5.0, 4.0, 3.0, 0.3), share=(0.4, 0.2, 0.5), remains=True)
    assert verdict(found) == "not-in-library"


@pytest.mark.parametrize(("high", "said"), [(0.79, "not-in-library"), (0.94, "partly-explained")])
def test_causes_that_no_choice_of_conditions_has_explain_nearly_all_of_a_plain_gap_are_impostors(high, said):
    lines = {"repeated": False, "size": 18.0, "chance_of_lines": 1e-9, "remains": True}
    assert verdict(findings(sizes=(300.0, 36.0, 18.0, 0.2), share=(0.75, 0.54, high), **lines)) == said


@pytest.mark.parametrize(("of_withheld", "of_seen"), [(0.96, 0.58), (0.74, 0.96)])
def test_where_repeats_tell_the_noise_a_share_is_asked_of_what_was_withheld_and_of_what_was_seen(
    of_withheld, of_seen
):
    right = findings(sizes=(60.0, 54.0, 10.8, 0.2), share=(0.96, 0.92, 0.97), remains=True)
    assert verdict(right) == "partly-explained"
    share = replace(right.shrinkage, value=of_withheld)
    assert verdict(replace(right, shrinkage=share, share_of_seen=of_seen)) == "not-in-library"


@pytest.mark.parametrize("repeated", [True, False])
def test_causes_that_a_law_explains_more_than_are_impostors_however_much_they_remove(repeated):
    plain = findings(
        sizes=(60.0, 54.0, 10.8, 0.2), share=(0.997, 0.99, 1.0), remains=True, repeated=repeated, size=18.0
    )
    assert verdict(plain) == "explained"
    assert verdict(replace(plain, better_alone="a mass on a spring that rides at hinge")) == "not-in-library"


def test_what_a_law_explains_and_no_candidate_does_is_not_in_the_library_though_nothing_of_it_is_learned():
    found = nothing_found(sizes=(60.0, 0.5, 0.5, 0.3))
    assert verdict(found) == "parameter"
    assert verdict(replace(found, better_alone="a mass on a spring that rides at hinge")) == "not-in-library"


def test_what_may_be_noise_of_the_rest_is_not_held_against_a_weak_cause():
    found = findings(sizes=(9.0, 2.0, 1.7, 0.2), share=(0.25, 0.1, 0.4), remains=True, repeated=False)
    assert verdict(found) == "explained"


def test_a_share_whose_interval_holds_none_may_help_nothing():
    assert may_help_nothing(findings(share=(0.3, -0.4, 1.54)))
    assert not may_help_nothing(findings())
    assert not may_help_nothing(nothing_found(sizes=(5.0, 0.8, 0.8, 0.3)))


@pytest.mark.parametrize(
    ("after", "repeated", "gap"),
    [(0.44, False, False), (1.2, False, True), (0.31, True, False), (0.5, True, True)],
)
def test_a_small_rest_that_can_be_learned_is_a_gap_only_well_above_what_noise_leaves(after, repeated, gap):
    sizes = (15.0, after, after, 0.26)
    assert nothing_found(sizes=sizes, learnable=0.9, size=0.5, repeated=repeated).left_is_gap == gap
    assert nothing_found(sizes=sizes, chance_of_lines=1e-9, size=0.5, repeated=repeated).left_is_gap


@pytest.mark.parametrize(
    ("share", "repeated", "stands"),
    [
        ((0.91, -0.07, 0.91), True, True),  # a condition that the parameters take up
        ((0.91, -0.65, 15.0), True, False),  # of what may be nothing
        ((0.5, -0.07, 0.9), True, False),
        ((0.91, -0.07, 0.91), False, False),
    ],
)
def test_a_cause_that_leaves_nothing_of_a_gap_beyond_noise_stands_though_it_helps_some_conditions_nothing(
    share, repeated, stands
):
    found = findings(sizes=(39.0, 0.36, 0.11, 0.17), share=share, repeated=repeated)
    assert may_help_nothing(found)
    without = nothing_found(sizes=(39.0, 0.33, 0.33, 0.17), repeated=repeated)
    assert not without.left_is_gap
    assert stands_all_the_same(found, without) == stands
    assert not stands_all_the_same(found, replace(without, remains=False))
    assert not stands_all_the_same(replace(found, remains=True), without)


@pytest.mark.parametrize(("removed", "stands"), [(0.42, False), (0.7, True)])
def test_without_repeats_what_may_help_nothing_stands_only_if_it_removes_more_than_it_leaves(removed, stands):
    found = findings(sizes=(54.0, 6.3, 4.8, 0.12), share=(removed, -0.4, 1.0), remains=True, repeated=False)
    plain = nothing_found(sizes=(54.0, 6.3, 6.3, 0.12), repeated=False, learnable=0.5)
    assert plain.left_is_gap and not found.left_is_gap
    assert stands_all_the_same(found, plain) == stands


def test_a_wrong_parameter_is_a_verdict_of_its_own():
    assert verdict(findings(effects=0, parameters=1)) == "parameter"


def test_a_wrong_parameter_that_leaves_a_plain_gap_is_a_part_of_the_answer_only():
    found = findings(
        sizes=(90.0, 56.0, 6.6, 0.14), share=(0.99, 0.9, 1.0), effects=0, parameters=1, remains=True
    )
    assert verdict(found) == "partly-explained"


def test_a_wrong_parameter_that_leaves_next_to_nothing_stays_one_however_little_it_removes():
    found = findings(
        sizes=(113.0, 0.5, 0.4, 0.3), share=(0.4, 0.1, 0.6), effects=0, parameters=1, remains=True
    )
    assert verdict(found) == "parameter"


def test_a_gap_that_nothing_explains_is_not_in_the_library_only_where_it_is_told_from_noise():
    small, plain = (5.0, 0.8, 0.8, 0.35), (5.0, 1.2, 1.2, 0.35)
    assert verdict(nothing_found(sizes=small, learnable=0.5)) == "not-in-library"
    assert verdict(nothing_found(sizes=small)) != "not-in-library"
    assert verdict(nothing_found(sizes=plain)) == "not-in-library"
    assert verdict(nothing_found(sizes=small, repeated=False)) == "parameter"
    assert verdict(nothing_found(sizes=small, remains=False)) == "parameter"


def test_what_is_no_more_than_noise_once_parameters_scatter_is_no_gap():
    mounted_anew = (0.5, 0.42, 0.42, 0.0)
    assert verdict(nothing_found(sizes=mounted_anew, size=1.2)) == "not-in-library"
    assert verdict(nothing_found(sizes=mounted_anew, size=0.9)) == "no-gap"


@pytest.mark.parametrize("repeated", [True, False])
def test_lines_tell_a_gap_of_the_size_of_the_noise_from_it(repeated):
    small = {"sizes": (5.0, 0.6, 0.6, 0.3), "repeated": repeated, "size": 1.1}
    assert verdict(nothing_found(**small, chance_of_lines=1e-6)) == "not-in-library"
    assert verdict(nothing_found(**small, chance_of_lines=1e-2)) == "parameter"
    assert verdict(nothing_found(**small, chance_of_lines=1e-6, remains=False)) == "parameter"


def test_what_is_plainly_more_than_a_sensor_adds_in_several_trials_is_a_gap_without_repeats():
    plain = {"sizes": (9.0, 8.5, 8.5, 0.3), "repeated": False}
    assert verdict(nothing_found(**plain, size=8.0)) == "not-in-library"
    assert verdict(nothing_found(**plain, size=4.0)) == "undecided"  # noise of a colour
    assert (
        verdict(nothing_found(**plain, size=8.0, trials=1)) == "undecided"
    )  # a disturbance may have made it
