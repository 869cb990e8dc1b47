"""Expressions of our TOML files: read once, computed many times, or written as source for numba.

They are computed on numbers, and element by element on arrays.
"""

# ruff: noqa: E731 - one small function for each node of a tree

import ast
import functools
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, PydanticKnownError, core_schema

from labrun.errors import SpecError
from labrun.toml.grammar import CONSTANTS, FUNCTIONS, ExpressionError, is_truth, parse
from labrun.toml.names import suggest

_LARGEST_INTEGER_POWER = 16


Array = NDArray[Any]
Compute = Callable[[Mapping[str, Any]], Any]
"""From what the names stand for to the value."""
Operand = float | str | Array
"""What a name may stand for: a number, a word, or an array, which broadcasts."""


@dataclass(frozen=True, slots=True)
class Expression:
    """A checked expression.

    A field of a pydantic model may be of this type: it takes numbers and text, and a fault of the text is one of the
    file.

    Attributes
    ----------
    given
        The number or text as it stands in the file.
    tree
        Its checked syntax tree.
    names : name -> position of its first use
        What it refers to except constants; the force at a site is ``"force.<site>"``, the time `t`.
    words
        Words in quotes, by position of their first use.
    """

    given: float | str
    tree: ast.expr = field(repr=False, compare=False)
    names: Mapping[str, int] = field(compare=False)
    words: Mapping[str, int] = field(compare=False)
    _compute: Compute = field(repr=False, compare=False)

    @classmethod
    def of(cls, given: "float | str | Expression") -> "Expression":
        """Return the expression of a number or a text, read once for each text.

        Raises
        ------
        ExpressionError
            The text is not of the language; see `labrun.toml.grammar`.
        """
        if isinstance(given, Expression):
            return given
        return _read(given) if isinstance(given, str) else _constant(given)

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to other processes as what was typed."""
        return Expression.of, (self.given,)

    @property
    def text(self) -> str:
        """As it was typed."""
        return str(self.given)

    @property
    def is_name(self) -> bool:
        """Tell whether it is one bare name."""
        return isinstance(self.tree, ast.Name)

    @property
    def is_comparison(self) -> bool:
        """Tell whether it says yes or no: comparisons, alone or joined by ``and``, ``or``, ``not``."""
        return _is_comparison(self.tree)

    def __call__(self, names: Mapping[str, Operand]) -> float | Array:
        """Compute it.

        Parameters
        ----------
        names
            What the names stand for; more than it needs do no harm.

        Returns
        -------
        float or ndarray
            A float if everything was scalar (a comparison gives 1 or 0), else an array (of bool for a comparison).

        Raises
        ------
        ExpressionError
            An unknown name (with the nearest known), or a result that is not a finite number.
        """
        if not isinstance(self.given, str):
            return float(self.given)
        for name in self.names:
            if name not in names:
                hint = suggest(name, names, kind="names")
                raise ExpressionError(self.text, f'unknown name "{name}"; {hint}', self.names[name])
        try:
            # what is not finite is found in the result, and said with its names
            with np.errstate(all="ignore"):
                result = self._compute(names)
        except (TypeError, ValueError, ArithmeticError) as error:
            raise ExpressionError(self.text, f"cannot be computed: {error}{self._values(names)}") from error
        if isinstance(result, float) and math.isfinite(result):
            return float(result)
        return self._finite(result, names)

    def source(self, variables: Mapping[str, str]) -> str:
        """Return Python source for numba, all numbers floats, with each name replaced by its variable's."""
        return numba_source(self.tree, variables)

    def _finite(self, result: Any, names: Mapping[str, Operand]) -> float | Array:
        array = np.asarray(result)
        if array.dtype.kind not in "fiub":
            raise ExpressionError(self.text, f"gives {result!r}, which is not a number")
        bad = ~np.isfinite(array)
        if bad.any():
            first = np.unravel_index(int(np.argmax(bad)), bad.shape)
            there = {name: _element(value, array.shape, first) for name, value in names.items()}
            raise ExpressionError(self.text, f"gives {array[first]}{self._values(there)}")
        if array.ndim == 0:
            return float(array)
        return array if array.dtype.kind == "b" else array.astype(float, copy=False)

    def _values(self, names: Mapping[str, Operand]) -> str:
        used = sorted(name for name in self.names if not isinstance(names[name], np.ndarray))
        return f" (with {', '.join(f'{name} = {names[name]}' for name in used)})" if used else ""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let fields of pydantic models be expressions."""
        return core_schema.no_info_plain_validator_function(
            _validated,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda expression: expression.given
            ),
        )


@functools.lru_cache(maxsize=4096)
def _read(text: str) -> Expression:
    parsed = parse(text)
    try:
        return Expression(text, parsed.tree, parsed.names, parsed.words, compiled(parsed.tree))
    except RecursionError:
        raise ExpressionError(text, "it is nested too deeply") from None


def _constant(value: float) -> Expression:
    return Expression(value, ast.Constant(value), {}, {}, lambda _: float(value))


def _validated(value: Any) -> Expression:
    if isinstance(value, bool) or not isinstance(value, int | float | str | Expression):
        raise PydanticCustomError("expression_type", "a number or text in quotes")
    if isinstance(value, float) and not math.isfinite(value):
        raise PydanticKnownError("finite_number")
    try:
        return Expression.of(value)
    except ExpressionError as error:
        raise PydanticCustomError("expression", "{text}", {"text": fault_of(error)}) from None


def fault_of(error: ExpressionError) -> str:
    """Return what is wrong with an expression, for a line that shows the expression already."""
    return error.reason + (f"; {error.hint}" if error.hint else "")


def _element(value: Operand, shape: tuple[int, ...], index: tuple[Any, ...]) -> Operand:
    """Return what a name stood for where an element of the result was computed."""
    if not isinstance(value, np.ndarray):
        return value
    try:
        element: Operand = np.broadcast_to(value, shape)[index].item()
    except ValueError:  # reduced on the way to the result
        return value
    return element


def _is_comparison(node: ast.expr) -> bool:
    match node:
        case ast.BoolOp(values=values):
            return all(_is_comparison(value) for value in values)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return _is_comparison(operand)
    return is_truth(node)


def evaluate(expression: float | str | Expression, names: Mapping[str, Operand]) -> float | Array:
    """Compute a number, a text, or an expression; see `Expression`."""
    return float(expression) if isinstance(expression, int | float) else Expression.of(expression)(names)


def names_in(expression: float | str | Expression) -> frozenset[str]:
    """Return the names an expression needs, without functions and constants."""
    return frozenset(Expression.of(expression).names)


def in_order(let: Mapping[str, float | str | Expression]) -> tuple[str, ...]:
    """Return the names of parts that may use each other such that each comes after those it uses.

    Raises
    ------
    ExpressionError
        One that cannot be read.
    SpecError
        Names that depend on each other in a circle.
    """
    graph = {name: names_in(expression) & let.keys() for name, expression in let.items()}
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise SpecError(f"let: {' -> '.join(error.args[1])} go round in a circle") from error


def resolve(
    let: Mapping[str, float | str | Expression], names: Mapping[str, Operand]
) -> dict[str, Operand | Array]:
    """Return `names` extended by the values of parts that may use each other.

    Raises
    ------
    SpecError
        As `in_order` and `Expression`.
    """
    known = dict(names)
    for name in in_order(let):
        known[name] = evaluate(let[name], known)
    return known


def numba_source(tree: ast.expr, variables: Mapping[str, str]) -> str:
    """Return Python source of a checked tree, all numbers floats, each name replaced by its variable's."""
    known = {**{name: f"math.{name}" for name in CONSTANTS}, "t": "t", **variables}
    return ast.unparse(ast.fix_missing_locations(ast.Expression(_written(tree, known))))


def _written(node: ast.expr, known: Mapping[str, str]) -> ast.expr:
    result: ast.expr
    match node:
        case ast.Constant(value=int() | float() as value):
            result = ast.Constant(float(value))
        case ast.Name(id=name):
            result = ast.Name(known[name])
        case ast.Attribute(attr=site):
            result = ast.Name(known[f"force.{site}"])
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            result = ast.UnaryOp(sign, _written(operand, known))
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            result = _power(_written(left, known), right, known)
        case ast.BinOp(left=left, op=operation, right=right):
            result = ast.BinOp(_written(left, known), operation, _written(right, known))
        case ast.IfExp(test=test, body=body, orelse=otherwise):
            result = _choice(test, _written(body, known), _written(otherwise, known), known)
        case ast.Call(func=ast.Name(id=name), args=arguments):
            result = _called(name, arguments, known)
        case _ if is_truth(node):
            result = _choice(node, ast.Constant(1.0), ast.Constant(0.0), known)
        case _:
            raise TypeError(f"{ast.unparse(node)} is a word, and compiled expressions have none")
    return result


def _choice(test: ast.expr, yes: ast.expr, no: ast.expr, known: Mapping[str, str]) -> ast.expr:
    return ast.IfExp(_written_truth(test, known), yes, no)


def _power(base: ast.expr, exponent: ast.expr, known: Mapping[str, str]) -> ast.expr:
    """Keep a small whole exponent an integer: the compiler then multiplies instead of calling pow.

    Any other power is a call, because Python folds ``(-1.0) ** 0.5`` to a complex constant; the call gives NaN.
    """
    match exponent:
        case ast.Constant(value=int() | float() as value):
            if float(value).is_integer() and value <= _LARGEST_INTEGER_POWER:
                return ast.BinOp(base, ast.Pow(), ast.Constant(int(value)))
    return _call("np.power", base, _written(exponent, known))


def _called(name: str, arguments: list[ast.expr], known: Mapping[str, str]) -> ast.expr:
    values = [_written(argument, known) for argument in arguments]
    match name:
        case "where":
            return _choice(arguments[0], values[1], values[2], known)
        case "clip":
            return _call("np.minimum", _call("np.maximum", values[0], values[1]), values[2])
        case "step":
            comparison = ast.Compare(values[0], [ast.GtE()], [values[1]])
            return ast.IfExp(comparison, ast.Constant(1.0), ast.Constant(0.0))
        case "min" | "max":
            result = values[0]
            for value in values[1:]:
                result = _call(FUNCTIONS[name].source, result, value)
            return result
    return _call(FUNCTIONS[name].source, *values)


def _written_truth(node: ast.expr, known: Mapping[str, str]) -> ast.expr:
    match node:
        case ast.Compare(left=left, ops=operators, comparators=others):
            return ast.Compare(_written(left, known), operators, [_written(other, known) for other in others])
        case ast.BoolOp(op=operator, values=values):
            return ast.BoolOp(operator, [_written_truth(value, known) for value in values])
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return ast.UnaryOp(ast.Not(), _written_truth(operand, known))
    return ast.Compare(_written(node, known), [ast.NotEq()], [ast.Constant(0.0)])


def _call(function: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(function), list(arguments), [])


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
    return _compute_truth(tree) if is_truth(tree) else _compute(tree)


def _compute(node: ast.expr) -> Compute:
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
            negated = _compute(inner)
            compute = lambda names: -negated(names)
        case ast.UnaryOp(op=ast.UAdd(), operand=inner):
            compute = _compute(inner)
        case ast.BinOp(left=left, op=operation, right=right):
            combine, first, other = _OPERATORS[type(operation)], _compute(left), _compute(right)
            compute = lambda names: combine(first(names), other(names))
        case (
            ast.IfExp(test=test, body=body, orelse=otherwise)
            | ast.Call(func=ast.Name(id="where"), args=[test, body, otherwise])
        ):
            condition, yes, no = _compute_truth(test), _compute(body), _compute(otherwise)
            compute = lambda names: np.where(condition(names), yes(names), no(names))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            function, values = FUNCTIONS[name].compute, [_compute(argument) for argument in arguments]
            compute = lambda names: function(*[value(names) for value in values])
        case _:  # what is left of a checked tree says yes or no
            truth = _compute_truth(node)
            compute = lambda names: np.multiply(truth(names), 1.0)
    return compute


def _operand(value: Any) -> Any:
    return np.float64(value) if isinstance(value, int | float) else value


def _compute_truth(node: ast.expr) -> Compute:
    match node:
        case ast.Compare(left=left, ops=relations, comparators=others):
            operands = [_compute(operand) for operand in (left, *others)]
            compare = [_OPERATORS[type(relation)] for relation in relations]
            return lambda names: _chain(compare, [_comparable(operand(names)) for operand in operands])
        case ast.BoolOp(op=operation, values=values):
            parts = [_compute_truth(value) for value in values]
            combine = np.logical_and if isinstance(operation, ast.And) else np.logical_or
            return lambda names: reduce(combine, [part(names) for part in parts])
        case ast.UnaryOp(op=ast.Not(), operand=inner):
            negated = _compute_truth(inner)
            return lambda names: np.logical_not(negated(names))
    number = _compute(node)
    return lambda names: np.not_equal(number(names), 0.0)


def _chain(compare: list[Callable[[Any, Any], Any]], values: list[Any]) -> Any:
    pairs = zip(compare, values, values[1:], strict=False)
    return reduce(np.logical_and, [relation(first, other) for relation, first, other in pairs])


def _comparable(value: Any) -> Any:
    """Refuse NaN where it would vanish: every comparison with it is just false."""
    missing = value != value if isinstance(value, float) else _has_nan(value)  # noqa: PLR0124 - what NaN is
    if missing:
        raise ValueError("a comparison with something that is not a number")
    return value


def _has_nan(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind == "f" and bool(np.isnan(value).any())
