import math
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrun.models import parse_model, simulate
from labrun.toml import FUNCTIONS, Expression, ExpressionError

NAMES = ("a", "b", "c")
REFERENCE = {
    **{
        name: getattr(np, name)
        for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "sign")
    },
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "abs": np.abs,
    "min": lambda *values: np.minimum.reduce(values),
    "max": lambda *values: np.maximum.reduce(values),
    "clip": lambda value, low, high: np.minimum(np.maximum(value, low), high),
}
_OPERATIONS = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.power,
    "**": np.power,
    "%": np.mod,
}


def _trees() -> st.SearchStrategy[tuple]:
    """Expressions as (text, function that evaluates it with NumPy), built apart from labrun's parser."""
    numbers = st.floats(0.01, 50, allow_nan=False).map(lambda v: (repr(v), lambda _: np.float64(v)))
    names = st.sampled_from(NAMES).map(lambda n: (n, lambda env: env[n]))

    def grow(inner):
        def binary(parts):
            operator, (left, f), (right, g) = parts
            operation = _OPERATIONS[operator]
            return f"({left}) {operator} ({right})", lambda env: operation(f(env), g(env))

        def call(parts):
            name, arguments = parts
            count = {"atan2": 2, "min": 3, "max": 2, "clip": 3}.get(name, 1)
            chosen = arguments[:count]
            text = f"{name}({', '.join(argument[0] for argument in chosen)})"
            return text, lambda env: REFERENCE[name](*(argument[1](env) for argument in chosen))

        def where(parts):
            (left, f), comparison, (right, g), (yes, h), (no, k) = parts
            test = {"<": np.less, ">=": np.greater_equal, "!=": np.not_equal}[comparison]
            text = f"where({left} {comparison} {right}, {yes}, {no})"
            return text, lambda env: h(env) if test(f(env), g(env)) else k(env)

        return st.one_of(
            st.tuples(st.sampled_from(["+", "-", "*", "/", "^", "**", "%"]), inner, inner).map(binary),
            st.tuples(st.sampled_from(sorted(REFERENCE)), st.tuples(inner, inner, inner)).map(call),
            st.tuples(inner, st.sampled_from(["<", ">=", "!="]), inner, inner, inner).map(where),
            inner.map(lambda term: (f"-({term[0]})", lambda env: -term[1](env))),
        )

    return st.recursive(st.one_of(numbers, names), grow, max_leaves=8)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(_trees(), min_size=8, max_size=8),
    st.tuples(*[st.floats(-20, 20).map(np.float64)] * 3),
)
def test_a_compiled_equation_gives_what_numpy_gives(trees, values):
    lines = [f'y{index} = "{text}"' for index, (text, _) in enumerate(trees)]
    text = 'name = "static"\ninputs = ["a", "b", "c"]\n[outputs]\n' + "\n".join(lines)
    model = parse_model(text, "static.toml")
    # a simulation stops at an output that is not finite, so the compiled function itself is asked
    out = _call(model.output.address, values, len(trees))
    with np.errstate(all="ignore"):
        expected = [float(function(dict(zip(NAMES, values, strict=True)))) for _, function in trees]
    for (source, _), result, wanted in zip(trees, out, expected, strict=True):
        if math.isfinite(wanted) and abs(wanted) < 1e12:
            assert result == pytest.approx(wanted, rel=1e-6, abs=1e-9), source
        elif math.isnan(wanted):
            assert math.isnan(result), source


def _call(address, inputs, count):
    import ctypes

    pointer = ctypes.POINTER(ctypes.c_double)
    function = ctypes.CFUNCTYPE(None, ctypes.c_double, *[pointer] * 5)(address)
    u, out, nothing = (ctypes.c_double * 3)(*inputs), (ctypes.c_double * count)(), (ctypes.c_double * 1)()
    function(0.0, nothing, u, nothing, nothing, out)
    return list(out)


_PIECES = "a t force. sin ( ) + - * / ^ . , 1 0 e < = ! _ open lambda : [ ] { ' \" \\ # if else not and or where clip"
_ALPHABET = st.sampled_from(
    [*_PIECES.split(), "import", " ", "\n", "\x00", "é", "await", "yield", "f'", "@", ";"]
)


@settings(max_examples=400, deadline=None)
@given(st.one_of(st.lists(_ALPHABET, max_size=25).map("".join), st.text(max_size=40)))
def test_any_text_is_either_an_equation_or_a_clear_error_and_never_runs(text):
    try:
        expression = Expression.of(text)
    except ExpressionError as error:
        assert str(error)
        assert 0 <= error.position <= len(text)
        return
    # what is compiled later is made of these words alone
    if expression.words:
        return
    source = expression.source(dict.fromkeys(expression.names, "v"))
    allowed = {
        "v",
        "t",
        "math",
        "np",
        "minimum",
        "maximum",
        "if",
        "else",
        "and",
        "or",
        "not",
        "e",
        "pi",
    } | set(FUNCTIONS)
    assert set(re.findall(r"[A-Za-z_]+", re.sub(r"\d[\d.]*(e[+-]?\d+)?", "", source))) <= allowed


def test_a_root_of_a_negative_constant_is_not_a_number_instead_of_complex():
    model = parse_model('name = "static"\n[outputs]\ny = "(-1)^0.5 + 2^0.5"\n', "static.toml")
    assert math.isnan(_call(model.output.address, (0.0,), 1)[0])


def test_powers_bind_as_in_mathematics():
    outputs = 'p = "-a^2"\nq = "2^a^2"\nr = "a^-1"\ns = "(a > 1) + (b > 1)"'
    text = f'name = "static"\ninputs = ["a", "b", "c"]\n[outputs]\n{outputs}'
    out = simulate(parse_model(text, "s"), np.zeros(1), np.array([[3.0, 0.5, 0.0]])).outputs[0]
    assert out == pytest.approx([-9.0, 512.0, 1 / 3, 1.0])


def test_long_sums_and_pi_and_time_are_fine():
    total = " + ".join(["a*pi"] * 100)
    text = f'name = "s"\ninputs = ["a"]\n[outputs]\ny = """{total}\n + t"""'
    out = simulate(parse_model(text, "s"), np.array([0.0, 2.0]), np.ones((2, 1))).outputs
    assert out[:, 0] == pytest.approx([100 * math.pi, 100 * math.pi + 2])
