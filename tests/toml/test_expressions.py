"""Expressions: what they compute, on numbers and on arrays, and what they refuse."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import SpecError
from labrun.toml import Expression, ExpressionError, evaluate, in_order, names_in, resolve


@settings(max_examples=30)
@given(st.floats(-60, 60), st.floats(-60, 60), st.floats(0.1, 5))
def test_numbers_come_out_as_python_computes_them(a, b, f):
    names = {"a": a, "b": b, "f": f}
    assert evaluate("-a + 2*b**2 - abs(b)/f", names) == pytest.approx(-a + 2 * b**2 - abs(b) / f)
    assert evaluate("a + abs(b) <= 60", names) == float(a + abs(b) <= 60)
    assert evaluate("max(a, b, 0) if f > 1 else min(a, b)", names) == (max(a, b, 0) if f > 1 else min(a, b))


@settings(max_examples=30)
@given(st.lists(st.floats(-100, 100), min_size=1, max_size=20))
def test_an_array_gives_what_its_elements_give_one_by_one(values):
    expression = "where(x > 0 and x < 50, sin(x) * 2, clip(x, -10, 10)) + step(x, 3)"
    together = evaluate(expression, {"x": np.array(values)})
    assert together.tolist() == [evaluate(expression, {"x": value}) for value in values]


def test_a_comparison_of_arrays_is_a_mask():
    mask = evaluate(
        "0 < a < 3 or not b <= 1", {"a": np.array([1.0, 5.0, 5.0]), "b": np.array([0.0, 0.0, 2.0])}
    )
    assert mask.dtype == bool
    assert mask.tolist() == [True, False, True]


def test_words_can_be_compared():
    assert evaluate('specimen == "wide" and w > 1', {"specimen": "wide", "w": 2}) == 1
    assert evaluate('specimen == "wide"', {"specimen": "narrow"}) == 0


def test_angles_are_radians():
    assert evaluate("sin(pi/2) + atan2(1, 1)", {}) == pytest.approx(1 + math.pi / 4)


def test_a_number_is_itself():
    assert evaluate(3, {}) == 3.0
    assert names_in(3) == frozenset()


def test_the_names_are_those_to_be_given():
    assert names_in("b + a*sin(2*pi*f*t)") == {"a", "b", "f", "t"}


def test_an_unknown_name_comes_with_the_nearest():
    with pytest.raises(
        ExpressionError, match=r'"alpha1 \* 2": unknown name "alpha1"; did you mean "alpha_1"\?'
    ):
        evaluate("alpha1 * 2", {"alpha_1": 1.0, "beta_1": 2.0})


@pytest.mark.parametrize(
    "expression",
    [
        "a.real", "a[0]", "[1, 2]", "(1, 2)", "{1: 2}", "lambda: 1", "[x for x in a]", "f'{a}'", "a := 1", "a; a",
        "__import__('os')", "open('x')", "eval('1')", "().__class__", "sin.__self__", "a // 2", "a << 2",
        "1 + ", "", "sin()", "sin(1, 2)", "sin(x=1)", "a if a", "None", "True", "1j", "b'x'", "(sin)(a).b", "sin(a)(a)",
        "*a", "a is a", "a in a", "'x' * 9", "'x' + 'y'", "sin", "(" * 500 + ")" * 500, "-" * 1999 + "1",
        "a + " * 600 + "a", "a @ a", "a = 1",
    ],
)  # fmt: skip
def test_what_is_no_expression_in_numbers_is_refused(expression):
    with pytest.raises(ExpressionError):
        evaluate(expression, {"a": 1.0})


@pytest.mark.parametrize(
    "expression", ["9**9**9**9", "1/(a - 1)", "(0 - 8)**0.5", "log(0)", "sqrt(0 - 1) < 3", "0/0 > 1"]
)
def test_what_has_no_finite_value_is_refused_and_not_passed_on(expression):
    with pytest.raises(ExpressionError):
        evaluate(expression, {"a": 1.0})


def test_a_value_that_is_not_finite_names_what_it_was_computed_from():
    with pytest.raises(ExpressionError, match=r"gives inf \(with a = 1.0\)"):
        evaluate("1/(a - 1)", {"a": 1.0, "b": 2.0})


@settings(max_examples=30)
@given(st.text(max_size=30))
def test_any_text_is_computed_or_refused(text):
    try:
        result = evaluate(text, {"a": 1.0})
    except ExpressionError:
        return
    assert math.isfinite(result)


def test_a_constraint_compares():
    assert Expression.of("a < 1 and (b > 2 or not c == 3)").is_comparison
    assert not Expression.of("a * b").is_comparison
    assert not Expression.of("a < 1 and b").is_comparison


def test_parts_of_let_are_computed_in_the_order_they_need_each_other():
    let = {"c": "a + b", "a": 1, "b": "2*a"}
    assert in_order(let).index("c") == 2
    assert resolve(let, {})["c"] == 3
    with pytest.raises(SpecError, match="circle"):
        in_order({"a": "b", "b": "a"})
