"""Checked expressions become functions that compute them, on numbers and element by element on arrays."""

# ruff: noqa: E731 - one small function for each node of a tree

import ast
import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import numpy as np

from labrun.toml.grammar import CONSTANTS, FUNCTIONS, is_truth

Compute = Callable[[Mapping[str, Any]], Any]
"""From what the names stand for to the value."""

_OPERATORS: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.true_divide,
    ast.Mod: np.mod,
    # in floating point: a power too large is an infinity, and never a number of a billion digits
    ast.Pow: np.float_power,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def compiled(tree: ast.expr) -> Compute:
    """Return the function that computes a checked tree: a comparison gives truth, anything else numbers."""
    return _truth(tree) if is_truth(tree) else _number(tree)


def _number(node: ast.expr) -> Compute:
    compute: Compute
    match node:
        case ast.Constant(value=value):
            constant = value if isinstance(value, str) else np.float64(value)  # type: ignore[arg-type]
            compute = lambda _: constant
        case ast.Name(id=name) if name in CONSTANTS:
            known = np.float64(CONSTANTS[name])
            compute = lambda _: known
        case ast.Name(id=name):
            compute = lambda names: _operand(names[name])
        case ast.Attribute(attr=site):
            compute = lambda names: _operand(names[f"force.{site}"])
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            negated = _number(inner)
            compute = lambda names: -negated(names)
        case ast.UnaryOp(op=ast.UAdd(), operand=inner):
            compute = _number(inner)
        case ast.BinOp(left=left, op=operation, right=right):
            combine, one, other = _OPERATORS[type(operation)], _number(left), _number(right)
            compute = lambda names: combine(one(names), other(names))
        case (
            ast.IfExp(test=test, body=body, orelse=otherwise)
            | ast.Call(func=ast.Name(id="where"), args=[test, body, otherwise])
        ):
            condition, yes, no = _truth(test), _number(body), _number(otherwise)
            compute = lambda names: np.where(condition(names), yes(names), no(names))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            function, values = FUNCTIONS[name].compute, [_number(argument) for argument in arguments]
            compute = lambda names: function(*[value(names) for value in values])
        case _:  # what is left of a checked tree says yes or no
            truth = _truth(node)
            compute = lambda names: np.multiply(truth(names), 1.0)
    return compute


def _operand(value: Any) -> Any:
    return np.float64(value) if isinstance(value, int | float) else value


def _truth(node: ast.expr) -> Compute:
    match node:
        case ast.Compare(left=left, ops=relations, comparators=others):
            operands = [_number(operand) for operand in (left, *others)]
            compare = [_OPERATORS[type(relation)] for relation in relations]
            return lambda names: _chain(compare, [_comparable(operand(names)) for operand in operands])
        case ast.BoolOp(op=operation, values=values):
            parts = [_truth(value) for value in values]
            combine = np.logical_and if isinstance(operation, ast.And) else np.logical_or
            return lambda names: reduce(combine, [part(names) for part in parts])
        case ast.UnaryOp(op=ast.Not(), operand=inner):
            negated = _truth(inner)
            return lambda names: np.logical_not(negated(names))
    number = _number(node)
    return lambda names: np.not_equal(number(names), 0.0)


def _chain(compare: list[Callable[[Any, Any], Any]], values: list[Any]) -> Any:
    pairs = zip(compare, values, values[1:], strict=False)
    return reduce(np.logical_and, [relation(one, other) for relation, one, other in pairs])


def _comparable(value: Any) -> Any:
    """Refuse NaN where it would vanish: every comparison with it is just false."""
    missing = value != value if isinstance(value, float) else _has_nan(value)  # noqa: PLR0124 - what NaN is
    if missing:
        raise ValueError("a comparison with something that is not a number")
    return value


def _has_nan(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind == "f" and bool(np.isnan(value).any())
