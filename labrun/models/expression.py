"""Equations as a person types them: parsed, checked against a whitelist, and turned into Python source."""

import ast
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from labrun.models.rewriting import CONSTANTS, UNARY, VARIADIC, as_number
from labrun.nearest import nearest as nearest_name

_FIXED_ARITY = {**dict.fromkeys(UNARY, 1), "atan2": 2, "clip": 3, "where": 3}
FUNCTIONS = frozenset(_FIXED_ARITY) | frozenset(VARIADIC)
"""Functions an equation may call."""
RESERVED = FUNCTIONS | {"t"}
"""Names a model's own quantities cannot have."""

_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.Mod)
_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
_LONGEST = 4000
_DEEPEST = 150
_ALIEN = re.compile(r"[^A-Za-z0-9_\s+\-*/%^().,<>=!]")
_HINTS = {
    "·": "write * for a product",
    "×": "write * for a product",
    "−": "write the hyphen - for a minus",
    "²": "write ^2 for a square",
    "#": "comments stand outside the quotes",
}


class ExpressionError(ValueError):
    """An equation that does not hold.

    Attributes
    ----------
    position
        Index of the offending character in the text as it was typed.
    hint
        What would do; may be empty.
    """

    def __init__(self, message: str, position: int, hint: str = "") -> None:
        super().__init__(message)
        self.position = position
        self.hint = hint


@dataclass(frozen=True)
class Expression:
    """One checked equation.

    Attributes
    ----------
    text
        As typed.
    tree
        Whitelisted syntax tree of the text.
    names : name -> position of its first use
        Everything it refers to but `t` and constants; the force at a site is ``"force.<site>"``.
    """

    text: str
    tree: ast.expr
    names: Mapping[str, int]

    @property
    def is_name(self) -> bool:
        """Whether it is one bare name."""
        return isinstance(self.tree, ast.Name)

    def source(self, variables: Mapping[str, str]) -> str:
        """Return Python source of it, all numbers floats, with each name replaced by its variable's."""
        known = {**CONSTANTS, "t": "t", **variables}
        return ast.unparse(ast.fix_missing_locations(ast.Expression(as_number(self.tree, known))))


def parse(text: str) -> Expression:
    """Parse one equation; runs nothing of it.

    Parameters
    ----------
    text
        Arithmetic with ``+ - * / % ^ **``, comparisons and ``and or not`` (a comparison used as a number is
        1 or 0), names, ``force.<site>`` and `FUNCTIONS`.

    Raises
    ------
    ExpressionError
        Anything else, with its position.
    """
    if len(text) > _LONGEST:
        raise ExpressionError(f"the equation has {len(text)} characters, more than {_LONGEST}", _LONGEST)
    alien = _ALIEN.search(text)
    if alien is not None:
        character = alien.group()
        raise ExpressionError(
            f"character {character!r} means nothing in an equation", alien.start(), _HINTS.get(character, "")
        )
    body = re.sub(r"\s", " ", text)
    lead = len(body) - len(body.lstrip())
    python, origin = _with_python_powers(body)
    if not python.strip():
        raise ExpressionError("the equation is empty", 0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about literals such as `1and`: the checks below say it better
            tree = ast.parse(python.strip(), mode="eval").body
    except SyntaxError as error:
        column = lead + error.offset - 1 if error.offset else len(python) - 1  # no offset: it ends too early
        raise ExpressionError(_syntax_message(error), origin[min(max(column, 0), len(origin) - 1)]) from None
    except (ValueError, RecursionError, MemoryError):
        raise ExpressionError("the equation is nested too deeply", 0) from None
    checker = _Checker(lead, origin)
    checker.number(tree, 0)
    return Expression(text, tree, checker.names)


def nearest(name: str, known: "list[str] | tuple[str, ...] | frozenset[str] | set[str]") -> str:
    """Return a hint that names the nearest known name, or lists all of them."""
    near = nearest_name(name, sorted(known))
    if near is not None:
        return f"did you mean {near!r}?"
    return f"known: {', '.join(sorted(known))}" if known else ""


def _with_python_powers(text: str) -> tuple[str, list[int]]:
    """Return the text with ``^`` as ``**``, and for each of its characters the index it came from."""
    out: list[str] = []
    origin: list[int] = []
    for index, character in enumerate(text):
        for piece in "**" if character == "^" else character:
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
        return "the equation is nested too deeply"
    if not error.offset:
        return "something is missing behind this"
    return "this does not go on as an equation would; is an operator missing?"


class _Checker:
    """Walks a tree once: refuses what is not whitelisted, notes the names."""

    def __init__(self, lead: int, origin: list[int]) -> None:
        self.names: dict[str, int] = {}
        self._lead = lead
        self._origin = origin

    def number(self, node: ast.expr, depth: int) -> None:
        if depth > _DEEPEST:
            raise self._error("the equation is nested too deeply", node)
        match node:
            case ast.Constant(value=value):
                self._constant(value, node)
            case ast.Name(id=name):
                self._name(name, node)
            case ast.Attribute(value=ast.Name(id="force"), attr=site):
                self.names.setdefault(f"force.{site}", self._position(node))
            case ast.Attribute():
                raise self._error("only force.<site> has a dot", node)
            case _:
                operands = self._arguments(node) if isinstance(node, ast.Call) else self._operands(node)
                for operand in operands:
                    self.number(operand, depth + 1)

    def _operands(self, node: ast.expr) -> list[ast.expr]:
        match node:
            case ast.UnaryOp(op=ast.UAdd() | ast.USub() | ast.Not(), operand=operand):
                return [operand]
            case ast.BinOp(left=left, op=operator, right=right) if isinstance(operator, _OPERATORS):
                return [left, right]
            case ast.BoolOp(values=values):
                return values
            case ast.Compare(left=left, ops=operators, comparators=others):
                if all(isinstance(one, _COMPARISONS) for one in operators):
                    return [left, *others]
                raise self._error("comparisons are < <= > >= == !=", node)
        raise self._error("this is not arithmetic", node)

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
            raise self._error(f"{name} is a function: give its arguments in parentheses", node)
        if name.startswith("__"):
            raise self._error(f"{name!r} is not a name for a quantity", node)
        if name != "t":
            self.names.setdefault(name, self._position(node))

    def _arguments(self, node: ast.Call) -> list[ast.expr]:
        function = node.func
        if not isinstance(function, ast.Name):
            raise self._error("this cannot be called; a product needs *", node)
        name = function.id
        if name not in FUNCTIONS:
            raise self._error(f"there is no function {name!r}", node, nearest(name, FUNCTIONS))
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self._error(f"{name} takes plain arguments", node)
        found, wanted = len(node.args), _FIXED_ARITY.get(name)
        if wanted is not None and found != wanted:
            raise self._error(f"{name} takes {wanted} argument{'s' * (wanted > 1)}, not {found}", node)
        if wanted is None and found < 2:
            raise self._error(f"{name} takes two or more arguments, not {found}", node)
        return node.args

    def _position(self, node: ast.expr) -> int:
        return self._origin[min(self._lead + node.col_offset, len(self._origin) - 1)]

    def _error(self, message: str, node: ast.expr, hint: str = "") -> ExpressionError:
        return ExpressionError(message, self._position(node), hint)
