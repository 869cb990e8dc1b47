"""Checked syntax trees of equations become Python source that numba compiles."""

import ast
from collections.abc import Mapping

UNARY = {
    "sin": "math.sin",
    "cos": "math.cos",
    "tan": "math.tan",
    "asin": "math.asin",
    "acos": "math.acos",
    "atan": "math.atan",
    "sinh": "math.sinh",
    "cosh": "math.cosh",
    "tanh": "math.tanh",
    "exp": "math.exp",
    "log": "math.log",
    "sqrt": "math.sqrt",
    "abs": "abs",
    "sign": "np.sign",
}
VARIADIC = {"min": "np.minimum", "max": "np.maximum"}
CONSTANTS = {"pi": "math.pi"}
_LARGEST_INTEGER_POWER = 16


def as_number(node: ast.expr, known: Mapping[str, str]) -> ast.expr:
    """Return a checked tree as float arithmetic, its names replaced by the source they stand for."""
    result: ast.expr
    match node:
        case ast.Constant():
            result = ast.Constant(_value(node))
        case ast.Name(id=name):
            result = ast.Name(known[name])
        case ast.Attribute(attr=site):
            result = ast.Name(known[f"force.{site}"])
        case ast.UnaryOp(op=ast.Not()) | ast.Compare() | ast.BoolOp():
            result = ast.IfExp(_truth(node, known), ast.Constant(1.0), ast.Constant(0.0))
        case ast.UnaryOp(op=operator, operand=operand):
            result = ast.UnaryOp(operator, as_number(operand, known))
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            result = _power(as_number(left, known), right, known)
        case ast.BinOp(left=left, op=operation, right=right):
            result = ast.BinOp(as_number(left, known), operation, as_number(right, known))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            result = _called(name, arguments, known)
        case _:
            raise AssertionError(f"unchecked node {ast.dump(node)}")
    return result


def _value(node: ast.Constant) -> float:
    assert isinstance(node.value, int | float)  # noqa: S101 - checked before
    return float(node.value)


def _power(base: ast.expr, exponent: ast.expr, known: Mapping[str, str]) -> ast.expr:
    """Keep a small whole exponent an integer: the compiler then multiplies instead of calling pow.

    Any other power is a call, because Python folds ``(-1.0) ** 0.5`` to a complex constant; the call gives NaN.
    """
    if isinstance(exponent, ast.Constant):
        value = _value(exponent)
        if value.is_integer() and value <= _LARGEST_INTEGER_POWER:
            return ast.BinOp(base, ast.Pow(), ast.Constant(int(value)))
    return _call("np.power", base, as_number(exponent, known))


def _called(name: str, arguments: list[ast.expr], known: Mapping[str, str]) -> ast.expr:
    if name == "where":
        condition, yes, no = arguments
        return ast.IfExp(_truth(condition, known), as_number(yes, known), as_number(no, known))
    values = [as_number(argument, known) for argument in arguments]
    if name == "clip":
        value, low, high = values
        return _call("np.minimum", _call("np.maximum", value, low), high)
    if name in VARIADIC:
        result = values[0]
        for value in values[1:]:
            result = _call(VARIADIC[name], result, value)
        return result
    return _call("math.atan2" if name == "atan2" else UNARY[name], *values)


def _truth(node: ast.expr, known: Mapping[str, str]) -> ast.expr:
    match node:
        case ast.Compare(left=left, ops=operators, comparators=others):
            return ast.Compare(
                as_number(left, known), operators, [as_number(other, known) for other in others]
            )
        case ast.BoolOp(op=operator, values=values):
            return ast.BoolOp(operator, [_truth(value, known) for value in values])
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return ast.UnaryOp(ast.Not(), _truth(operand, known))
    return ast.Compare(as_number(node, known), [ast.NotEq()], [ast.Constant(0.0)])


def _call(function: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(function), list(arguments), [])
