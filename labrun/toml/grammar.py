"""The one language of expressions: experiments, objectives, models and effects are written in it.

Arithmetic with ``+ - * / % ^`` (``**`` is ``^``), comparisons (as a number 1 or 0), ``and or not``, ``x if c else y``,
names, words in quotes to compare with, and the functions of `FUNCTIONS`. It is Python's syntax; nothing of it is
ever run by Python: its tree is checked here, node by node, and only then computed (`labrun.toml.expressions`) or
written as source for numba (`labrun.toml.expressions`).
"""

import ast
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from labrun.errors import SpecError
from labrun.toml.names import suggest


class Function(NamedTuple):
    """A function of the language.

    Attributes
    ----------
    least, most
        Numbers of values it takes.
    meaning
        For the documentation.
    compute
        Of numbers and arrays.
    source
        How numba calls it; of the functions that need more than a call, empty.
    """

    least: int
    most: int
    meaning: str
    compute: Callable[..., Any]
    source: str = ""


def _folded(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    return lambda *values: reduce(function, values)


FUNCTIONS: dict[str, Function] = {
    "sin": Function(1, 1, "sine of an angle in radians", np.sin, "math.sin"),
    "cos": Function(1, 1, "cosine of an angle in radians", np.cos, "math.cos"),
    "tan": Function(1, 1, "tangent of an angle in radians", np.tan, "math.tan"),
    "asin": Function(1, 1, "inverse sine, radians", np.arcsin, "math.asin"),
    "acos": Function(1, 1, "inverse cosine, radians", np.arccos, "math.acos"),
    "atan": Function(1, 1, "inverse tangent, radians", np.arctan, "math.atan"),
    "atan2": Function(2, 2, "angle of the point (x, y) as `atan2(y, x)`, radians", np.arctan2, "math.atan2"),
    "sinh": Function(1, 1, "hyperbolic sine", np.sinh, "math.sinh"),
    "cosh": Function(1, 1, "hyperbolic cosine", np.cosh, "math.cosh"),
    "tanh": Function(1, 1, "hyperbolic tangent", np.tanh, "math.tanh"),
    "exp": Function(1, 1, "e to the power of x", np.exp, "math.exp"),
    "log": Function(1, 1, "natural logarithm", np.log, "math.log"),
    "sqrt": Function(1, 1, "square root", np.sqrt, "math.sqrt"),
    "abs": Function(1, 1, "magnitude", np.abs, "abs"),
    "sign": Function(1, 1, "-1, 0 or 1", np.sign, "np.sign"),
    "min": Function(2, 99, "least of two or more values", _folded(np.minimum), "np.minimum"),
    "max": Function(2, 99, "greatest of two or more values", _folded(np.maximum), "np.maximum"),
    "clip": Function(3, 3, "`clip(x, low, high)`: x within bounds", np.clip),
    "where": Function(3, 3, "`where(c, x, y)`: x where the comparison c holds, else y", np.where),
    "step": Function(
        2, 2, "`step(t, t0)`: 0 before t0, 1 from then on", lambda time, start: np.where(time >= start, 1.0, 0.0)
    ),
}  # fmt: skip
"""All functions there are, by name."""
CONSTANTS = {"pi": float(np.pi)}
RESERVED = frozenset(FUNCTIONS) | frozenset(CONSTANTS) | {"t"}
"""Names that already mean something, so that a quantity cannot have them; `t` is the time, s."""

_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.Mod)
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
_LONGEST = 4000
"""Characters: far above any equation, far below what exhausts the parser."""
_DEEPEST = 150
_WORD = re.compile(r"'[^'\\]*'|\"[^\"\\]*\"")
_ALIEN = re.compile(r"[^\w\s+\-*/%^().,<>=!]|[²³]")
_HINTS = {
    "·": "write * for a product",
    "×": "write * for a product",
    "−": "write the hyphen - for a minus",
    "²": "write ^2 for a square",
    "³": "write ^3 for a cube",
    "#": "comments stand outside the quotes",
}


class ExpressionError(SpecError):
    """An expression that cannot be read or computed.

    Attributes
    ----------
    text
        The expression.
    reason
        What is wrong with it.
    position
        Index of the offending character in the text as it was typed.
    """

    def __init__(self, text: str, reason: str, position: int = 0, hint: str | None = None) -> None:
        super().__init__(f'expression "{text}": {reason}', hint=hint or None)
        self.text = text
        self.reason = reason
        self.position = position


@dataclass(frozen=True, slots=True)
class Parsed:
    """A checked tree, and what stands where in its text.

    Attributes
    ----------
    names, words : name -> position of its first use
        What it refers to except constants (the force at a site is ``"force.<site>"``), and the words in quotes.
    """

    tree: ast.expr
    names: dict[str, int] = field(default_factory=dict)
    words: dict[str, int] = field(default_factory=dict)


def parse(text: str) -> Parsed:
    """Parse and check an expression; runs nothing of it.

    Raises ExpressionError: whatever is not of the language, with its position.
    """
    if len(text) > _LONGEST:
        raise ExpressionError(text[:40] + "...", f"{len(text)} characters are too many (at most {_LONGEST})")
    # words may hold anything, and are looked at no further
    body = re.sub(r"\s", " ", _WORD.sub(lambda word: "'" + "w" * (len(word[0]) - 2) + "'", text))
    alien = _ALIEN.search(body.replace("'", " "))
    if alien is not None:
        character = alien.group()
        reason = f"character {character!r} means nothing in an expression"
        raise ExpressionError(text, reason, alien.start(), _HINTS.get(character))
    python, origin = _with_python_powers(re.sub(r"\s", " ", text))
    if not python.strip():
        raise ExpressionError(text, "it is empty")
    lead = len(python) - len(python.lstrip())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about literals such as `1and`: the checks below say it better
            tree = ast.parse(python.strip(), mode="eval").body
    except SyntaxError as error:
        column = lead + error.offset - 1 if error.offset else len(python) - 1  # no offset: it ends too early
        position = origin[min(max(column, 0), len(origin) - 1)]
        raise ExpressionError(text, _syntax_message(error), position) from None
    except (ValueError, RecursionError, MemoryError):
        raise ExpressionError(text, "it is nested too deeply") from None
    checker = _Checker(text, python.strip(), lead, origin)
    checker.check(tree, 0)
    return Parsed(tree, checker.names, checker.words)


def is_truth(node: ast.expr) -> bool:
    """Tell whether a node says yes or no, before it counts as 1 or 0."""
    return isinstance(node, ast.Compare | ast.BoolOp) or (
        isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
    )


def _with_python_powers(text: str) -> tuple[str, list[int]]:
    """Return the text with ``^`` as ``**`` outside of words, and for each of its characters the index it came from."""
    inside = {index for word in _WORD.finditer(text) for index in range(*word.span())}
    out: list[str] = []
    origin: list[int] = []
    for index, character in enumerate(text):
        for piece in "**" if character == "^" and index not in inside else character:
            out.append(piece)
            origin.append(index)
    return "".join(out), [*origin, len(text)]


def _syntax_message(error: SyntaxError) -> str:
    message = error.msg or ""
    if "never closed" in message:
        return "this parenthesis is never closed"
    if "unmatched" in message:
        return "this parenthesis was never opened"
    if "too many nested" in message:
        return "it is nested too deeply"
    if not error.offset:
        return "something is missing behind this"
    return "the expression does not continue here; is an operator missing?"


class _Checker:
    """Walks a tree once: refuses what is not of the language, notes names and words."""

    def __init__(self, text: str, python: str, lead: int, origin: list[int]) -> None:
        self.names: dict[str, int] = {}
        self.words: dict[str, int] = {}
        self._text = text
        self._python = python.encode()
        self._lead = lead
        self._origin = origin

    def check(self, node: ast.expr, depth: int) -> None:
        if depth > _DEEPEST:
            raise self._error("it is nested too deeply", node)
        match node:
            case ast.Constant(value=str(word)):
                self.words.setdefault(word, self._position(node))
            case ast.Constant(value=value):
                self._constant(value, node)
            case ast.Name(id=name):
                self._name(name, node)
            case ast.Attribute(value=ast.Name(id="force"), attr=site):
                self.names.setdefault(f"force.{site}", self._position(node))
            case ast.Attribute():
                raise self._error("only force.<site> has a dot", node)
            case _:
                for operand in self._arguments(node) if isinstance(node, ast.Call) else self._operands(node):
                    self.check(operand, depth + 1)

    def _operands(self, node: ast.expr) -> list[ast.expr]:
        match node:
            case ast.UnaryOp(op=ast.UAdd() | ast.USub() | ast.Not(), operand=operand):
                return [operand]
            case ast.BinOp(left=left, op=operator, right=right) if isinstance(operator, _OPERATORS):
                return [left, right]
            case ast.BoolOp(values=values):
                return values
            case ast.IfExp(test=test, body=body, orelse=otherwise):
                return [test, body, otherwise]
            case ast.Compare(left=left, ops=operators, comparators=others):
                if all(isinstance(operator, _COMPARISONS) for operator in operators):
                    return [left, *others]
                raise self._error("comparisons are < <= > >= == !=", node)
        raise self._error(
            "this is not arithmetic", node, "numbers, names, + - * / ^ %, comparisons, functions"
        )

    def _constant(self, value: object, node: ast.expr) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error(f"{value!r} is not a real number", node)
        try:
            finite = abs(float(value)) < float("inf")
        except OverflowError:
            finite = False
        if not finite:
            raise self._error("the number is too large", node)

    def _name(self, name: str, node: ast.expr) -> None:
        if name in FUNCTIONS:
            raise self._error(f"{name} is a function: give its values in parentheses", node)
        if name.startswith("__"):
            raise self._error(f"{name!r} is not a name for a quantity", node)
        if name not in CONSTANTS:
            self.names.setdefault(name, self._position(node))

    def _arguments(self, node: ast.Call) -> list[ast.expr]:
        called = node.func
        if not isinstance(called, ast.Name):
            raise self._error("this cannot be called; a product needs *", node)
        name = called.id
        if name not in FUNCTIONS:
            hint = suggest(name, sorted(FUNCTIONS), kind="functions")
            raise self._error(f"unknown function {name!r}", node, hint)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self._error(f"{name} takes plain values", node)
        count, function = len(node.args), FUNCTIONS[name]
        if not function.least <= count <= function.most:
            takes = "two or more" if function.most > function.least else str(function.least)
            raise self._error(f"{name} takes {takes} value{'s' * (takes != '1')}, not {count}", node)
        return node.args

    def _position(self, node: ast.expr) -> int:
        column = len(self._python[: node.col_offset].decode(errors="replace"))  # the tree counts bytes
        return self._origin[min(self._lead + column, len(self._origin) - 1)]

    def _error(self, reason: str, node: ast.expr, hint: str | None = None) -> ExpressionError:
        return ExpressionError(self._text, reason, self._position(node), hint)
