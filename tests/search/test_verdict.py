"""A search says whether it is done."""

import numpy as np
import pytest

from labrun.search import Verdict
from labrun.search.ending import judge

SHRINKING = [0.3 * 0.9**n for n in range(12)]


def verdict(spreads, *, budget_spent=True, is_constant=False, goal=None):
    return judge(
        "12 generations",
        spreads,
        budget_spent=budget_spent,
        is_constant=is_constant,
        goal=goal,
        trials=240,
        trials_each=20,
        generations=12,
    )


def test_a_spent_budget_tells_what_it_would_still_take_at_the_pace_so_far():
    result = verdict(SHRINKING)
    expected = np.log(0.02 / SHRINKING[-1]) / np.log(0.9)
    assert result.ending == "budget spent"
    assert result.further_generations == int(np.ceil(expected))
    assert result.further_trials == 20 * result.further_generations
    assert "not converged" in result.text


def test_one_generation_more_is_one():
    assert "about 1 more generation (20 trials)" in verdict([*SHRINKING, 0.021]).text
    assert "more generations (" in verdict(SHRINKING).text


@pytest.mark.parametrize("spreads", [[0.3] * 12, [0.3, 0.2, 0.1], [0.3 * 1.05**n for n in range(12)], []])
def test_candidates_that_do_not_draw_together_give_no_number(spreads):
    result = verdict(spreads)
    assert result.further_generations is None
    assert "nobody can say" in result.text


def test_a_narrow_spread_is_converged_whatever_ended_the_search():
    assert verdict([0.3, 0.019]).ending == "converged"
    assert verdict([0.3, 0.019], goal=0.01).ending == "budget spent"
    assert verdict([0.3, 0.009], goal=0.01, budget_spent=False).ending == "converged"


def test_no_progress_at_a_wide_spread_is_stagnation():
    result = verdict(SHRINKING, budget_spent=False)
    assert result.ending == "stagnated"
    assert "noise" in result.text


def test_a_verdict_comes_back_from_its_record():
    result = verdict(SHRINKING)
    assert Verdict.from_record(result.to_record()) == result


def test_an_objective_that_never_changes_does_not_depend_on_the_parameters():
    result = verdict(SHRINKING, budget_spent=False, is_constant=True)
    assert result.ending == "constant"
    assert "does not depend on the parameters" in result.text
    assert "noise" not in result.text
