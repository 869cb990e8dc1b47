import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.errors import PlanError, SpecError
from labrun.experiment import Range, Sweep
from labrun.search import Constraint, sweep_conditions
from labrun.search.planned import axis_values


def grid(axes, **keys):
    return sweep_conditions(Sweep.model_validate({"axes": axes, **keys}), seed=0)


@given(
    start=st.integers(-500, 500),
    step=st.integers(1, 50),
    count=st.integers(1, 60),
    digits=st.integers(0, 4),
    rest=st.floats(0, 0.99),
)
def test_a_range_includes_both_ends_and_has_no_floating_point_dust(start, step, count, digits, rest):
    scale = 10**digits
    exact = [(start + index * step) / scale for index in range(count)]
    stop = (start + (count - 1) * step + int(rest * step)) / scale
    axis = Range.model_validate({"from": start / scale, "to": stop, "step": step / scale})
    assert axis_values(axis) == exact


@given(
    a=st.lists(st.integers(-9, 9), min_size=1, max_size=5, unique=True),
    b=st.lists(st.integers(-9, 9), min_size=1, max_size=5, unique=True),
    bound=st.integers(-18, 18),
)
def test_a_constrained_grid_is_the_crossed_grid_without_what_violates(a, b, bound):
    expected = [{"a": float(x), "b": float(y)} for x, y in itertools.product(a, b) if x + abs(y) <= bound]
    axes = {"a": a, "b": b}
    if expected:
        assert grid(axes, where=[f"a + abs(b) <= {bound}"]) == expected
    else:
        with pytest.raises(PlanError, match="leave nothing"):
            grid(axes, where=[f"a + abs(b) <= {bound}"])


def test_the_thrust_sweep_keeps_its_best_point_which_lies_on_two_constraints():
    axes = {
        "b": {"from": -20, "to": 20, "step": 5},
        "a": {"from": 10, "to": 60, "step": 5},
        "f": {"from": 0.2, "to": 3, "step": 0.2},
    }
    result = grid(axes, where=["a + abs(b) <= 60", "a * f <= 84"])
    assert {"b": 0.0, "a": 60.0, "f": 1.4} in result
    assert all(c["a"] + abs(c["b"]) <= 60 and c["a"] * c["f"] <= 84 + 1e-9 for c in result)


def test_words_are_values_of_an_axis_and_can_be_constrained():
    result = grid({"fin": ["soft", "stiff"], "f": [1, 2]}, where=['fin == "soft" or f < 2'])
    assert result == [{"fin": "soft", "f": 1.0}, {"fin": "soft", "f": 2.0}, {"fin": "stiff", "f": 1.0}]


def test_constraints_that_leave_nothing_name_the_one_that_removes_most():
    with pytest.raises(PlanError) as caught:
        grid({"a": [1, 2, 3, 4]}, where=["a > 2", "a < 2"])
    assert "'a < 2' alone removes 3 of 4" in str(caught.value)


@pytest.mark.parametrize("design", ["random", "sobol"])
def test_a_sampled_design_fills_its_feasible_region_with_as_many_points_as_asked(design):
    sweep = Sweep.model_validate(
        {
            "design": design,
            "samples": 100,
            "axes": {"a": {"from": 0, "to": 2}, "b": {"from": -1, "to": 1}},
            "where": ["a + b <= 1"],
        }
    )
    conditions = sweep_conditions(sweep, seed=3)
    assert len(conditions) == 100
    assert all(0 <= c["a"] <= 2 and -1 <= c["b"] <= 1 and c["a"] + c["b"] <= 1 for c in conditions)
    assert conditions == sweep_conditions(sweep, seed=3)
    assert conditions != sweep_conditions(sweep, seed=4)


def test_a_sobol_design_is_more_even_than_a_random_one():
    from scipy.stats import qmc

    def discrepancy(design):
        axes = {"a": {"from": 0, "to": 1}, "b": {"from": 0, "to": 1}}
        sweep = Sweep.model_validate({"design": design, "samples": 256, "axes": axes})
        return qmc.discrepancy(np.array([[c["a"], c["b"]] for c in sweep_conditions(sweep, seed=1)]))

    assert discrepancy("sobol") < 0.5 * discrepancy("random")


def test_a_sampled_design_that_its_constraints_leave_empty_says_so():
    sweep = Sweep.model_validate(
        {"design": "random", "samples": 5, "axes": {"a": {"from": 0, "to": 1}}, "where": ["a > 2"]}
    )
    with pytest.raises(PlanError, match="'a > 2' alone removes"):
        sweep_conditions(sweep, seed=0)


@given(a=st.floats(-100, 100), b=st.floats(-100, 100))
def test_a_violation_is_the_distance_from_holding(a, b):
    violation = float(Constraint("a <= b").violation({"a": a, "b": b}))
    assert violation >= 0
    if a <= b:
        assert violation == 0
    elif a - b > 1e-6:
        assert violation == pytest.approx(a - b)


@given(a=st.floats(-10, 10), b=st.floats(-10, 10))
def test_and_adds_misses_while_or_takes_the_least(a, b):
    names = {"a": a, "b": b}
    left, right = (float(Constraint(text).violation(names)) for text in ("a <= 0", "b <= 0"))
    assert float(Constraint("a <= 0 and b <= 0").violation(names)) == pytest.approx(left + right)
    assert float(Constraint("a <= 0 or b <= 0").violation(names)) == pytest.approx(min(left, right))


@pytest.mark.parametrize("text", ["a + 1", "__import__('os')", "a <=", "a in b"])
def test_what_is_no_comparison_is_refused_when_it_is_read(text):
    with pytest.raises(SpecError, match=r"constraint|expression"):
        Constraint(text)


def test_what_must_not_hold_misses_where_it_does():
    assert not Constraint("not a < 1").holds({"a": 0.5})
    assert Constraint("not a < 1").holds({"a": 1.0})


def test_a_step_that_is_too_small_is_refused_before_its_points_are_made():
    sweep = Sweep.model_validate({"axes": {"a": {"from": 0, "to": 60, "step": 1e-9}}})
    with pytest.raises(PlanError, match=r"60,000,000,001 points \(a: 60,000,000,001\)"):
        sweep_conditions(sweep, 0)
