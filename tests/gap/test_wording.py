"""The verdict's sentence says on which data a share was found."""

from dataclasses import replace

import pytest
from labrun.gap.verdict import VerdictBasis, limitations, sentence

from labrun.gap.diagnosis import BeyondScatter, Cause, Name, ResampledNumber, Shrinkage, Sizes

CAUSES = (Cause(Name("bias", "angle"), 0.8, {"offset": ResampledNumber(0.1, 0.0, 0.2, "rad")}),)


def said(verdict: str, conditions: int) -> str:
    sizes = Sizes(6.0, 4.0, 0.2, 0.3)
    return sentence(verdict, sizes, CAUSES, Shrinkage(0.98, 0.9, 1.0), (), conditions=conditions)


@pytest.mark.parametrize("verdict", ["explained", "parameter", "partly-explained"])
def test_of_one_condition_no_share_is_told_on_conditions_the_fit_did_not_see(verdict: str) -> None:
    assert "on blocks of time the fit did not see, as there is one condition only" in said(verdict, 1)
    assert "conditions the fit did not see" not in said(verdict, 1)
    assert "one condition only" not in said(verdict, 4)


@pytest.mark.parametrize("verdict", ["explained", "parameter"])
def test_of_several_conditions_the_share_is_of_those_the_fit_did_not_see(verdict: str) -> None:
    assert "98 % of the gap on conditions the fit did not see" in said(verdict, 2)


@pytest.mark.parametrize("single", [True, False])
def test_one_condition_is_a_limitation(single: bool) -> None:
    told = limitations(
        repeats=1 if single else 3,
        enough=False,
        conditions=1,
        basis="repeats",
        single_trial=single,
        rejected=0,
    )
    assert any("One condition only" in one for one in told)
    assert any("One trial only" in one for one in told) == single


@pytest.mark.parametrize("enough", [True, False])
def test_conditions_measured_once_are_a_limitation_unless_others_tell_the_noise(enough: bool) -> None:
    told = limitations(
        repeats=1, enough=enough, conditions=8, basis="repeats", single_trial=False, rejected=0
    )
    assert any("the noise floor is uncertain" in one for one in told) == (not enough)


def test_a_rest_beyond_noise_is_said_beside_a_cause_that_explains_the_gap() -> None:
    sizes = Sizes(12.0, 10.0, 1.0, 0.1)
    told = sentence("explained", sizes, CAUSES, Shrinkage(0.98, 0.9, 1.0), (), conditions=4, rest=True)
    assert told.endswith("that rest is more than noise: nature's form may be another one, or there is more.")
    little = Sizes(12.0, 10.0, 0.4, 0.1)
    told = sentence("explained", little, CAUSES, Shrinkage(0.98, 0.9, 1.0), (), conditions=4, rest=True)
    assert "that rest is small, but not all of it noise" in told
    plain = VerdictBasis(sizes, True, True, 1, 0, Shrinkage(0.98, 0.9, 1.0), BeyondScatter(size=2.0))
    assert plain.left_is_gap
    assert not replace(plain, sizes=Sizes(12.0, 10.0, 0.12, 0.1)).left_is_gap
    unrepeated = replace(plain, noise_known=False)
    assert not unrepeated.left_is_gap
    assert replace(unrepeated, beyond_scatter=BeyondScatter(0.5)).left_is_gap  # what is predicted is no noise


def test_a_gap_above_the_floor_that_is_called_noise_is_not_said_to_be_below_it() -> None:
    told = sentence("no-gap", Sizes(0.9, 0.79, 0.79, 0.39), (), None, (), conditions=4)
    assert "0.79 times one trial's noise, more than repeats let expect (0.39)" in told
    assert "up to" in sentence("no-gap", Sizes(0.9, 0.3, 0.3, 0.39), (), None, (), conditions=4)


def test_what_may_be_noise_alone_is_not_told_as_a_gap_that_nothing_explains() -> None:
    small, plain = Sizes(0.5, 0.44, 0.44, 0.2), Sizes(5.0, 4.4, 4.4, 0.2)
    assert sentence("undecided", small, (), None, (), conditions=4, noise_known=False).startswith(
        "No gap that stands out of noise: what model and measurement differ by (0.44 times the noise of a sample)"
    )
    assert "it is a gap, or disturbances" in sentence(
        "undecided", plain, (), None, (), conditions=4, noise_known=False
    )
    calibrated = sentence("parameter", replace(small, raw=9.0), (), None, (), conditions=4, noise_known=False)
    assert calibrated.endswith("0.44 times the noise of a sample, and the rest may be noise.")


def test_what_is_nearest_is_all_that_was_chosen_with_the_share_it_removes() -> None:
    sizes, share = Sizes(60.0, 54.0, 11.0, 0.2), Shrinkage(0.96, 0.92, 0.97)
    nearest = (Name("drift", "speed"), Name("bias", "thrust"))
    told = sentence("not-in-library", sizes, (), share, nearest, conditions=4)
    assert "the nearest, drift at speed and bias at thrust, remove 96 % of it" in told


def test_what_another_law_explains_more_than_is_told_with_that_law() -> None:
    told = sentence(
        "not-in-library",
        Sizes(31.0, 2.3, 0.6, 0.15),
        (),
        Shrinkage(0.93, 0.9, 0.95),
        (Name("added-inertia", "elbow"),),
        conditions=4,
        better_alone="a mass on a spring that rides at elbow",
    )
    assert told.endswith(
        "removes 93 % of it, but a mass on a spring that rides at elbow explains more without it."
    )
