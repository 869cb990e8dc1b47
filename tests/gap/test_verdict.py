"""From sizes and shares to a verdict."""

import pytest

from labrun.gap.diagnosis import BeyondScatter, Shrinkage, Sizes
from labrun.gap.verdict import VerdictBasis, verdict


def findings(
    *, sizes=(5.0, 4.0, 0.2, 0.3), share=(0.98, 0.9, 1.0), effects=1, parameters=0, remains=False, **more
):
    return VerdictBasis(
        Sizes(*sizes),
        more.get("significant", True),
        remains,
        more.get("repeated", True),
        effects,
        parameters,
        None if share is None else Shrinkage(*share),
        BeyondScatter(more.get("learnable", 0.0), more.get("size", 2.0), more.get("chance_of_lines", 1.0)),
        more.get("trials", 5),
    )


def test_a_cause_that_leaves_nothing_explains_the_gap():
    assert verdict(findings()) == "explained"


def test_a_cause_that_leaves_much_explains_it_in_part():
    found = findings(sizes=(5.0, 4.0, 0.4, 0.3), share=(0.8, 0.7, 1.0), remains=True)
    assert verdict(found) == "partly-explained"


def test_what_removes_too_little_to_be_the_cause_is_not_taken_for_one():
    assert verdict(findings(share=(0.4, 0.2, 0.5), remains=True)) == "not-in-library"


@pytest.mark.parametrize(("raw", "said"), [(34.0, "parameter"), (0.3, "undecided")])
def test_a_cause_whose_help_on_withheld_conditions_may_be_nothing_is_not_announced(raw, said):
    found = findings(sizes=(raw, 0.27, 0.22, 0.13), share=(0.3, -0.4, 1.54), repeated=False)
    assert found.unproven
    assert verdict(found) == said


def test_a_wrong_parameter_whose_help_may_be_nothing_is_not_announced_either():
    found = findings(
        sizes=(2.0, 0.29, 0.22, 0.1), share=(0.45, -0.21, 1.21), effects=0, parameters=1, repeated=False
    )
    assert found.unproven
    assert verdict(found) == "parameter"  # recalibration does it


def test_a_plain_gap_stays_one_where_nothing_that_was_found_is_announced():
    found = findings(sizes=(17.0, 4.6, 3.0, 0.1), share=(0.32, -0.39, 0.55), remains=True)
    assert found.unproven
    assert verdict(found) == "not-in-library"


def test_all_of_a_gap_that_may_be_nothing_is_no_proof_of_a_cause():
    found = findings(sizes=(1.0, 0.4, 0.1, 0.35), share=(1.0, -0.65, 15.0))
    assert found.unproven
    assert verdict(found) != "explained"


def test_a_cause_that_few_conditions_show_is_announced_where_it_removes_nearly_all():
    found = findings(share=(0.95, -0.04, 0.99))
    assert not found.unproven
    assert verdict(found) == "explained"


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
    unexplained = {"effects": 0, "share": None, "sizes": (5.0, 0.8, 0.8, 0.3)}
    assert verdict(findings(**unexplained, learnable=0.5)) == "not-in-library"
    assert verdict(findings(**unexplained)) != "not-in-library"
    assert verdict(findings(**{**unexplained, "sizes": (5.0, 1.2, 1.2, 0.3)})) == "not-in-library"
    assert verdict(findings(**unexplained, repeated=False)) == "parameter"
    assert verdict(findings(**unexplained, significant=False)) == "parameter"


def test_what_is_no_more_than_noise_once_parameters_scatter_is_no_gap():
    mounted_anew = {"effects": 0, "share": None, "sizes": (0.5, 0.42, 0.42, 0.0)}
    assert verdict(findings(**mounted_anew, size=1.2)) == "not-in-library"
    assert verdict(findings(**mounted_anew, size=0.9)) == "no-gap"


def test_lines_tell_a_gap_of_the_size_of_the_noise_from_it_where_nothing_else_tells_the_noise():
    unexplained = {"effects": 0, "share": None, "sizes": (5.0, 1.2, 1.2, 0.3), "repeated": False}
    assert verdict(findings(**unexplained, size=1.1, chance_of_lines=1e-6)) == "not-in-library"
    assert verdict(findings(**unexplained, size=1.1, chance_of_lines=1e-2)) == "parameter"
    assert verdict(findings(**unexplained, size=0.6, chance_of_lines=1e-6)) == "parameter"


def test_what_is_plainly_more_than_a_sensor_adds_in_several_trials_is_a_gap_without_repeats():
    plain = {"effects": 0, "share": None, "sizes": (9.0, 8.5, 8.5, 0.3), "repeated": False}
    assert verdict(findings(**plain, size=8.0)) == "not-in-library"
    assert verdict(findings(**plain, size=4.0)) == "undecided"  # noise of a colour
    assert verdict(findings(**plain, size=8.0, trials=1)) == "undecided"  # a disturbance may have made it
