"""The rule that decides: which model replaces which, which candidate leads, and how often it wins."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.gap.decide import (
    beats,
    chosen_without_each_unit,
    compare,
    leader,
    near_best,
    resamples,
    win_frequencies,
)


@dataclass(frozen=True)
class Tables:
    """Log errors (candidates, units) with the condition of each unit and the complexity of each candidate."""

    errors: np.ndarray
    strata: np.ndarray
    complexity: list[tuple[int, int]]
    base: np.ndarray


@st.composite
def tables(draw: st.DrawFn) -> Tables:
    """Return tables whose candidates differ from hardly to plainly, in one to eight conditions of one or more units."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    candidates, conditions = draw(st.integers(1, 6)), draw(st.integers(1, 8))
    strata = np.repeat(np.arange(conditions), draw(st.integers(1, 4)))
    scatter, apart = draw(st.sampled_from([0.01, 0.3, 2.0])), draw(st.sampled_from([0.0, 0.5, 4.0]))
    shared = rng.standard_normal(len(strata))
    errors = (
        shared
        + apart * rng.random((candidates, 1))
        + scatter * rng.standard_normal((candidates, len(strata)))
    )
    ranks = rng.permutation(candidates)  # no two candidates are equally complex
    complexity = [(int(rng.integers(1, 4)), int(rank)) for rank in ranks]
    base = shared + apart + scatter * rng.standard_normal(len(strata))
    return Tables(errors, strata, complexity, base)


@given(tables())
def test_a_model_never_replaces_itself(table: Tables) -> None:
    for row in table.errors:
        assert not beats(row, row, table.strata)


@given(tables())
def test_two_models_never_replace_each_other(table: Tables) -> None:
    first, second = table.base, table.errors[0]
    assert not (beats(first, second, table.strata) and beats(second, first, table.strata))


@given(tables())
def test_the_best_never_beats_the_leader_and_no_near_candidate_has_fewer_parameters(table: Tables) -> None:
    row = leader(table.errors, table.complexity, table.strata)
    near = near_best(table.errors, table.strata)
    assert np.mean(table.errors[near[0]]) == pytest.approx(np.min(np.mean(table.errors, axis=1)))
    assert not beats(table.errors[near[0]], table.errors[row], table.strata)
    assert table.complexity[row][0] == min(table.complexity[other][0] for other in near)


@given(tables(), st.floats(-20.0, 20.0))
def test_the_unit_of_the_errors_decides_nothing(table: Tables, constant: float) -> None:
    def decisions(shift: float) -> tuple[int, list[int], list[bool]]:
        errors, base = table.errors + shift, table.base + shift
        row = leader(errors, table.complexity, table.strata)
        near = sorted(near_best(errors, table.strata).tolist())
        return row, near, [beats(other, base, table.strata) for other in errors]

    assert decisions(constant) == decisions(0.0)


@given(tables(), st.integers(0, 99))
def test_candidates_win_no_more_often_than_there_are_resamples_in_whatever_order_they_stand(
    table: Tables, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    drawn = resamples(table.strata, 30, rng)
    wins = win_frequencies(table.base, table.errors, table.complexity, table.strata, drawn)
    assert np.all(wins >= 0.0)
    assert np.sum(wins) <= 1.0 + 1e-12
    order = rng.permutation(len(table.errors))
    reordered = [table.complexity[row] for row in order]
    again = win_frequencies(table.base, table.errors[order], reordered, table.strata, drawn)
    np.testing.assert_allclose(again, wins[order])


@given(tables(), st.integers(2, 4))
def test_more_units_of_the_same_scatter_never_take_a_decision_back(table: Tables, times: int) -> None:
    """More conditions, or more blocks of time in each: the mean stays, and the standard error only falls."""
    row, count = table.errors[0], len(np.unique(table.strata))
    more_conditions = np.concatenate([table.strata + copy * count for copy in range(times)])
    for strata in (more_conditions, np.tile(table.strata, times)):
        before, after = np.tile(table.base, times), np.tile(row, times)
        assert compare(before, after, strata).mean == pytest.approx(
            compare(table.base, row, table.strata).mean
        )
        if beats(row, table.base, table.strata):
            assert beats(after, before, strata)


@given(tables(), st.integers(0, 99))
def test_a_resample_keeps_the_number_of_units_of_each_condition(table: Tables, seed: int) -> None:
    drawn = resamples(table.strata, 5, np.random.default_rng(seed))
    assert drawn.shape == (5, len(table.strata))
    for units in drawn:
        np.testing.assert_array_equal(np.bincount(table.strata[units]), np.bincount(table.strata))


def test_one_unit_alone_decides_nothing() -> None:
    assert not beats(np.array([-9.0]), np.array([0.0]), np.array([0]))


def test_blocks_of_time_of_one_condition_do_not_stand_for_conditions_that_disagree() -> None:
    # each of two conditions agrees with itself in eight blocks, but one gains what the other loses, and a little more
    strata = np.repeat([0, 1], 8)
    gain = np.where(strata == 0, 1.5, -0.9)
    assert not beats(-gain, np.zeros(16), strata)


def test_what_improves_every_unit_by_next_to_nothing_is_no_better_in_practice() -> None:
    strata = np.arange(8)
    assert not beats(np.full(8, -0.01), np.zeros(8), strata)
    assert beats(np.full(8, -0.7), np.zeros(8), strata)


def test_a_simpler_candidate_leads_where_a_richer_one_predicts_no_better() -> None:
    rng = np.random.default_rng(0)
    simple = rng.standard_normal(8)
    richer = simple - 0.1 + rng.permutation(np.linspace(-1.0, 1.0, 8))
    far_richer = simple - 3.0
    strata = np.arange(8)
    assert leader(np.array([richer, simple]), [(3, 0), (1, 0)], strata) == 1
    assert leader(np.array([far_richer, simple]), [(3, 0), (1, 0)], strata) == 0


def test_of_candidates_that_predict_the_same_the_most_common_in_practice_leads() -> None:
    rng = np.random.default_rng(0)
    rare = rng.standard_normal(8)
    common = rare + rng.permutation(np.linspace(-0.02, 0.02, 8))
    assert leader(np.array([rare, common]), [(1, 9), (1, 2)], np.arange(8)) == 1


def test_a_candidate_that_is_always_best_always_wins_and_one_that_never_helps_never_does() -> None:
    strata = np.arange(8)
    base, rng = np.zeros(8), np.random.default_rng(1)
    errors = np.array([np.full(8, -3.0), np.zeros(8)]) + 0.1 * rng.standard_normal((2, 8))
    drawn = resamples(strata, 50, rng)
    assert win_frequencies(base, errors, [(1, 0), (1, 1)], strata, drawn).tolist() == [1.0, 0.0]
    assert win_frequencies(base, errors[1:], [(1, 1)], strata, drawn).tolist() == [0.0]


@given(tables())
def test_the_choice_without_a_unit_does_not_depend_on_that_units_errors(table: Tables) -> None:
    errors = np.vstack([table.base, table.errors])
    complexity = [(0, 0), *table.complexity]
    before = chosen_without_each_unit(errors, complexity, table.strata)
    changed = errors.copy()
    changed[:, 0] = -changed[:, 0]
    assert chosen_without_each_unit(changed, complexity, table.strata)[0] == before[0]


def test_a_candidate_that_wins_by_one_condition_alone_is_not_chosen_for_that_condition() -> None:
    strata = np.arange(4)
    errors = np.array([[0.0, 0.0, 0.0, 0.0], [-9.0, 0.0, 0.0, 0.0], [-0.5, -0.5, -0.6, -0.5]])
    assert chosen_without_each_unit(errors, [(0, 0), (1, 0), (1, 1)], strata)[0] == 2
