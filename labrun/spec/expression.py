"""Expressions of an experiment file: parsed by simpleeval, never by `eval`, and computed on whole arrays.

Numbers, names, ``+ - * / ** %``, comparisons, ``and or not``, ``x if c else y``, and the functions of `FUNCTIONS`.
Angles of trigonometric functions are in radians.
"""

import ast
import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from simpleeval import InvalidExpression, SimpleEval

from labrun.errors import SpecError
from labrun.spec.names import suggest

Array = NDArray[Any]
Operand = float | str | Array

_LENGTH = 2000
"""Longest expression, in characters: far above any gait, far below what exhausts the parser."""


class ExpressionError(SpecError):
    """An expression cannot be read or computed."""


def _fold(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    return lambda *values: functools.reduce(function, values)


FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int]] = {
    "sin": (np.sin, 1, 1),
    "cos": (np.cos, 1, 1),
    "tan": (np.tan, 1, 1),
    "asin": (np.arcsin, 1, 1),
    "acos": (np.arccos, 1, 1),
    "atan": (np.arctan, 1, 1),
    "atan2": (np.arctan2, 2, 2),
    "sqrt": (np.sqrt, 1, 1),
    "exp": (np.exp, 1, 1),
    "log": (np.log, 1, 1),
    "abs": (np.abs, 1, 1),
    "sign": (np.sign, 1, 1),
    "min": (_fold(np.minimum), 2, 9),
    "max": (_fold(np.maximum), 2, 9),
    "clip": (np.clip, 3, 3),
    "where": (np.where, 3, 3),
    "step": (lambda time, start: np.where(time >= start, 1.0, 0.0), 2, 2),
}
"""Functions, with the least and the greatest number of values they take.

``step(t, t0)`` is 0 before t0 and 1 from then on.
"""

CONSTANTS = {"pi": float(np.pi)}

_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.true_divide,
    ast.Mod: np.mod,
    # In floating point: a power too large is an infinity, found below, and never a number of a billion digits.
    ast.Pow: np.float_power,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: np.logical_not,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


class _Evaluator(SimpleEval):  # type: ignore[misc]  # simpleeval has no types
    """simpleeval with logic that works element by element, and nothing that reaches into objects."""

    def __init__(self, names: Mapping[str, Operand]) -> None:
        functions = {name: function for name, (function, _, _) in FUNCTIONS.items()}
        super().__init__(operators=_OPERATORS, functions=functions, names={**CONSTANTS, **names})
        self.nodes = {
            ast.Expr: self._eval_expr,
            ast.Name: self._eval_name,
            ast.UnaryOp: self._eval_unaryop,
            ast.BinOp: self._eval_binop,
            ast.BoolOp: self._eval_boolop,
            ast.Compare: self._eval_compare,
            ast.IfExp: self._eval_ifexp,
            ast.Call: self._eval_call,
            ast.Constant: self._eval_constant,
        }

    def _eval_constant(self, node: ast.Constant) -> Operand:
        return node.value if isinstance(node.value, str) else np.float64(node.value)  # type: ignore[arg-type]

    def _eval_boolop(self, node: ast.BoolOp) -> Any:
        combine = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
        return functools.reduce(combine, [self._eval(value) for value in node.values])

    def _eval_compare(self, node: ast.Compare) -> Any:
        operands = [_number(self._eval(item)) for item in (node.left, *node.comparators)]
        pairs = [
            _OPERATORS[type(relation)](left, right)
            for relation, left, right in zip(node.ops, operands, operands[1:], strict=False)
        ]
        return functools.reduce(np.logical_and, pairs)

    def _eval_ifexp(self, node: ast.IfExp) -> Any:
        return np.where(self._eval(node.test), self._eval(node.body), self._eval(node.orelse))


def _number(operand: Any) -> Any:
    """Refuse NaN where it would vanish: every comparison with it is just false."""
    if not isinstance(operand, str) and np.isnan(operand).any():
        raise ValueError("a comparison with something that is not a number")
    return operand


_MODES = (ast.expr_context, ast.boolop, ast.operator, ast.unaryop, ast.cmpop)
_LEAVES = (
    ast.Expr,
    ast.Name,
    ast.UnaryOp,
    ast.BinOp,
    ast.BoolOp,
    ast.Compare,
    ast.IfExp,
    ast.Call,
    ast.Constant,
)
_LOGIC = (ast.And, ast.Or, ast.Load)


@functools.lru_cache(maxsize=4096)
def _parse(expression: str) -> tuple[ast.Expr, frozenset[str]]:
    """Return the tree of an expression and the names it needs; raise ExpressionError on anything it may not hold."""
    if len(expression) > _LENGTH:
        raise ExpressionError(f"expression of {len(expression)} characters is too long (at most {_LENGTH})")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or str(error) or "too deeply nested"
        raise ExpressionError(f'expression "{expression}" cannot be read: {reason}') from error
    needed: set[str] = set()
    called = {node.func for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree.body):
        _check_node(node, expression)
        if isinstance(node, ast.Name) and node not in called and node.id not in CONSTANTS:
            needed.add(node.id)
    return ast.Expr(tree.body), frozenset(needed)


def _check_node(node: ast.AST, expression: str) -> None:
    if isinstance(node, ast.Call):
        _check_call(node, expression)
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, bool) or not isinstance(node.value, int | float | str):
            raise ExpressionError(f'expression "{expression}": {node.value!r} is neither a number nor a word')
    elif isinstance(node, ast.BitXor):
        raise ExpressionError(f'expression "{expression}": ^ is not known; a power is written **')
    elif isinstance(node, _MODES):
        if type(node) not in _OPERATORS and not isinstance(node, _LOGIC):
            raise ExpressionError(f'expression "{expression}": {type(node).__name__} is not an operator here')
    elif not isinstance(node, _LEAVES):
        raise ExpressionError(
            f'expression "{expression}" may not hold {_described(node)}',
            hint="numbers, names, + - * / ** %, comparisons, and/or/not, and " + " ".join(FUNCTIONS),
        )


def _described(node: ast.AST) -> str:
    names = {"Attribute": "a dot between names", "Subscript": "square brackets", "Lambda": "lambda"}
    return names.get(type(node).__name__, f"a {type(node).__name__}")


def _check_call(node: ast.Call, expression: str) -> None:
    if not isinstance(node.func, ast.Name):
        raise ExpressionError(f'expression "{expression}": only functions by name can be called')
    name = node.func.id
    if name not in FUNCTIONS:
        hint = suggest(name, FUNCTIONS, kind="functions")
        raise ExpressionError(f'expression "{expression}": unknown function "{name}"; {hint}')
    _, least, most = FUNCTIONS[name]
    count = len(node.args)
    if node.keywords or not least <= count <= most:
        takes = f"{least}" if least == most else f"{least} to {most}"
        raise ExpressionError(f'expression "{expression}": {name} takes {takes} values, found {count}')


def names_in(expression: float | str) -> frozenset[str]:
    """Return the names an expression needs, without functions and constants.

    Raises
    ------
    ExpressionError
        The expression cannot be read, or holds what an expression may not.
    """
    return _parse(expression)[1] if isinstance(expression, str) else frozenset()


def _check_known(expression: str, needed: frozenset[str], known: Mapping[str, Operand]) -> None:
    for name in sorted(needed):
        if name not in known:
            hint = suggest(name, known, kind="names")
            raise ExpressionError(f'expression "{expression}": unknown name "{name}"; {hint}')


def evaluate(expression: float | str, names: Mapping[str, Operand]) -> float | Array:
    """Compute an expression.

    Parameters
    ----------
    expression
        A number, or text such as ``"20 + abs(40 * sin(2*pi*0.005*t))"``.
    names
        What the names stand for: numbers, words (to compare with), or arrays, which broadcast.

    Returns
    -------
    float or ndarray
        A float if everything was scalar (a comparison gives 1 or 0), else an array (of bool for a comparison).

    Raises
    ------
    ExpressionError
        Unreadable, an unknown name (with the nearest known), or a result that is not a finite number.
    """
    if not isinstance(expression, str):
        return float(expression)
    tree, needed = _parse(expression)
    _check_known(expression, needed, names)
    return _finite(_run(tree, expression, names), expression, names)


def _run(tree: ast.AST, expression: str, names: Mapping[str, Operand]) -> Any:
    try:
        with np.errstate(
            all="ignore"
        ):  # what is not finite is found in the result, in words that name the expression
            return _Evaluator(names)._eval(tree)
    except (InvalidExpression, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise ExpressionError(
            f'expression "{expression}" cannot be computed: {error}{_values(names, tree)}'
        ) from error


def _finite(result: Any, expression: str, names: Mapping[str, Operand]) -> float | Array:
    array = np.asarray(result)
    if array.dtype.kind not in "fiub":
        raise ExpressionError(f'expression "{expression}" gives {result!r}, which is not a number')
    bad = ~np.isfinite(array)
    if bad.any():
        first = np.unravel_index(int(np.argmax(bad)), bad.shape)
        tree = _parse(expression)[0]
        there = {name: _element(value, array.shape, first) for name, value in names.items()}
        raise ExpressionError(f'expression "{expression}" gives {array[first]}{_values(there, tree)}')
    if array.ndim == 0:
        return float(array)
    return array if array.dtype.kind == "b" else array.astype(float, copy=False)


def _element(value: Operand, shape: tuple[int, ...], index: tuple[Any, ...]) -> Operand:
    """Return what a name stood for where an element of the result was computed."""
    if not isinstance(value, np.ndarray):
        return value
    try:
        element: Operand = np.broadcast_to(value, shape)[index].item()
    except ValueError:  # reduced on the way to the result
        return value
    return element


def _values(names: Mapping[str, Operand], tree: ast.AST) -> str:
    used = sorted({node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} & set(names))
    texts = [f"{name} = {names[name]}" for name in used if not isinstance(names[name], np.ndarray)]
    return f" (with {', '.join(texts)})" if texts else ""


def is_comparison(expression: str) -> bool:
    """Tell whether an expression says yes or no: comparisons, alone or joined by ``and``, ``or``, ``not``."""
    return _says_yes_or_no(_parse(expression)[0].value)


def _says_yes_or_no(node: ast.expr) -> bool:
    if isinstance(node, ast.BoolOp):
        return all(_says_yes_or_no(value) for value in node.values)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return _says_yes_or_no(node.operand)
    return isinstance(node, ast.Compare)
