"""The verdict's sentence says on which data a share was found."""

import pytest

from labrun.gap.diagnosis import Cause, Estimate, Name, Shrinkage, Sizes
from labrun.gap.verdict import limitations, sentence

CAUSES = (Cause(Name("bias", "angle"), 0.8, {"offset": Estimate(0.1, 0.0, 0.2, "rad")}),)


def said(verdict: str, conditions: int) -> str:
    sizes = Sizes(6.0, 4.0, 0.2, 0.3)
    return sentence(verdict, sizes, CAUSES, Shrinkage(0.98, 0.9, 1.0), None, conditions=conditions)


@pytest.mark.parametrize("verdict", ["explained", "parameter", "partly-explained"])
def test_of_one_condition_no_share_is_told_on_conditions_the_fit_did_not_see(verdict: str) -> None:
    assert "on the data of the fit, as there is one condition only" in said(verdict, 1)
    assert "did not see" not in said(verdict, 1)
    assert "one condition only" not in said(verdict, 4)


@pytest.mark.parametrize("verdict", ["explained", "parameter"])
def test_of_several_conditions_the_share_is_of_those_the_fit_did_not_see(verdict: str) -> None:
    assert "98 % of the gap on conditions the fit did not see" in said(verdict, 2)


@pytest.mark.parametrize("single", [True, False])
def test_one_condition_is_a_limitation(single: bool) -> None:
    told = limitations(
        repeats=1 if single else 3, conditions=1, basis="repeats", single_trial=single, rejected=0
    )
    assert any("One condition only" in one for one in told)
    assert any("One trial only" in one for one in told) == single
