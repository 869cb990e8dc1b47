"""Checked expressions become Python source that numba compiles: float arithmetic on scalars."""

import ast
from collections.abc import Mapping

from labrun.toml.grammar import CONSTANTS, FUNCTIONS, is_truth

_LARGEST_INTEGER_POWER = 16


def numba_source(tree: ast.expr, variables: Mapping[str, str]) -> str:
    """Return Python source of a checked tree, all numbers floats, each name replaced by its variable's."""
    known = {**{name: f"math.{name}" for name in CONSTANTS}, "t": "t", **variables}
    return ast.unparse(ast.fix_missing_locations(ast.Expression(_number(tree, known))))


def _number(node: ast.expr, known: Mapping[str, str]) -> ast.expr:
    result: ast.expr
    match node:
        case ast.Constant(value=int() | float() as value):
            result = ast.Constant(float(value))
        case ast.Name(id=name):
            result = ast.Name(known[name])
        case ast.Attribute(attr=site):
            result = ast.Name(known[f"force.{site}"])
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            result = ast.UnaryOp(sign, _number(operand, known))
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            result = _power(_number(left, known), right, known)
        case ast.BinOp(left=left, op=operation, right=right):
            result = ast.BinOp(_number(left, known), operation, _number(right, known))
        case ast.IfExp(test=test, body=body, orelse=otherwise):
            result = _choice(test, _number(body, known), _number(otherwise, known), known)
        case ast.Call(func=ast.Name(id=name), args=arguments):
            result = _called(name, arguments, known)
        case _ if is_truth(node):
            result = _choice(node, ast.Constant(1.0), ast.Constant(0.0), known)
        case _:
            raise TypeError(f"{ast.unparse(node)} is a word, and compiled expressions have none")
    return result


def _choice(test: ast.expr, yes: ast.expr, no: ast.expr, known: Mapping[str, str]) -> ast.expr:
    return ast.IfExp(_truth(test, known), yes, no)


def _power(base: ast.expr, exponent: ast.expr, known: Mapping[str, str]) -> ast.expr:
    """Keep a small whole exponent an integer: the compiler then multiplies instead of calling pow.

    Any other power is a call, because Python folds ``(-1.0) ** 0.5`` to a complex constant; the call gives NaN.
    """
    match exponent:
        case ast.Constant(value=int() | float() as value):
            if float(value).is_integer() and value <= _LARGEST_INTEGER_POWER:
                return ast.BinOp(base, ast.Pow(), ast.Constant(int(value)))
    return _call("np.power", base, _number(exponent, known))


def _called(name: str, arguments: list[ast.expr], known: Mapping[str, str]) -> ast.expr:
    values = [_number(argument, known) for argument in arguments]
    match name:
        case "where":
            return _choice(arguments[0], values[1], values[2], known)
        case "clip":
            return _call("np.minimum", _call("np.maximum", values[0], values[1]), values[2])
        case "step":
            begun = ast.Compare(values[0], [ast.GtE()], [values[1]])
            return ast.IfExp(begun, ast.Constant(1.0), ast.Constant(0.0))
        case "min" | "max":
            result = values[0]
            for value in values[1:]:
                result = _call(FUNCTIONS[name].source, result, value)
            return result
    return _call(FUNCTIONS[name].source, *values)


def _truth(node: ast.expr, known: Mapping[str, str]) -> ast.expr:
    match node:
        case ast.Compare(left=left, ops=operators, comparators=others):
            return ast.Compare(_number(left, known), operators, [_number(other, known) for other in others])
        case ast.BoolOp(op=operator, values=values):
            return ast.BoolOp(operator, [_truth(value, known) for value in values])
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return ast.UnaryOp(ast.Not(), _truth(operand, known))
    return ast.Compare(_number(node, known), [ast.NotEq()], [ast.Constant(0.0)])


def _call(function: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(function), list(arguments), [])
