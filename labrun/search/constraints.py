"""Constraints on conditions (`where`): whether they hold, and by how much they do not."""

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.errors import SpecError
from labrun.toml import ExpressionError, KeyPath, dotted, evaluate

FloatArray = NDArray[np.float64]

_TOLERANCE = 1e-9
"""Relative: 60 * 1.4 <= 84 holds whatever the last bit of the product is."""

_COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)


@dataclass(frozen=True)
class Constraint:
    """One `where` expression: comparisons, joined by `and` and `or` (chains such as ``0 < a < b`` included).

    Attributes
    ----------
    text
        The expression as the file has it.
    key
        Where in the file that is, such as ``("sweep", "where", 0)``.

    Raises
    ------
    SpecError
        The text is no comparison.
    """

    text: str
    key: KeyPath = ()

    def __post_init__(self) -> None:
        _check(self._tree(), self.text)

    def holds(self, names: Mapping[str, object]) -> NDArray[np.bool_]:
        """Tell where the constraint holds; arrays of names give an array, numbers an array of no dimension."""
        return np.asarray(self.violation(names) == 0.0)

    def violation(self, names: Mapping[str, object]) -> FloatArray:
        """Return by how much the two sides miss the comparison: 0 where it holds, positive elsewhere.

        In the unit of the expression's sides. Under `and` the misses add up, under `or` the least one counts.
        Words that are not equal (or must not be) miss by 1.

        Raises
        ------
        ConstraintError
            It cannot be computed there, for example because a root of something negative is not a number.
        """
        try:
            return np.asarray(_violation(self._tree(), names), dtype=float)
        except ExpressionError as error:
            raise ConstraintError(self, str(error)) from error

    def _tree(self) -> ast.expr:
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except SyntaxError as error:
            raise SpecError(f"constraint {self.text!r} cannot be read: {error.msg}") from error


class ConstraintError(SpecError):
    """A constraint that cannot be computed for the values it has to judge.

    Attributes
    ----------
    key
        Where in the file the constraint stands.
    """

    def __init__(self, constraint: Constraint, reason: str) -> None:
        place = f"{dotted(constraint.key)}: " if constraint.key else ""
        super().__init__(
            f"{place}constraint {constraint.text!r}: {reason}",
            hint="a constraint needs a finite value everywhere in the ranges of what varies",
        )
        self.key = constraint.key


def constraints(texts: Sequence[str], table: str = "") -> list[Constraint]:
    """Return the constraints of a file's `where` list, which stands in `table`."""
    return [Constraint(text, (table, "where", n) if table else ()) for n, text in enumerate(texts)]


def _check(tree: ast.expr, text: str) -> None:
    if isinstance(tree, ast.BoolOp):
        for part in tree.values:
            _check(part, text)
    elif not isinstance(tree, ast.Compare) or not all(isinstance(op, _COMPARISONS) for op in tree.ops):
        raise SpecError(
            f"constraint {text!r} is not a comparison",
            hint='a constraint compares two expressions: "a + abs(b) <= 60", also with and / or',
        )


def _violation(tree: ast.expr, names: Mapping[str, object]) -> FloatArray:
    if isinstance(tree, ast.BoolOp):
        parts = np.broadcast_arrays(*(_violation(part, names) for part in tree.values))
        combine = np.sum if isinstance(tree.op, ast.And) else np.min
        return np.asarray(combine(np.stack(parts), axis=0), dtype=float)
    assert isinstance(tree, ast.Compare)  # noqa: S101  (what _check let through)
    sides = [tree.left, *tree.comparators]
    misses = [
        _miss(op, left, right, names) for op, left, right in zip(tree.ops, sides, sides[1:], strict=False)
    ]
    return np.asarray(sum(misses), dtype=float)


def _miss(op: ast.cmpop, left: ast.expr, right: ast.expr, names: Mapping[str, object]) -> FloatArray:
    one, other = _side(left, names), _side(right, names)
    if not (np.issubdtype(one.dtype, np.number) and np.issubdtype(other.dtype, np.number)):
        equal = np.asarray(one == other)
        return np.asarray(equal if isinstance(op, ast.NotEq) else ~equal, dtype=float)
    a, b = one.astype(float), other.astype(float)
    slack = _TOLERANCE * np.maximum(np.abs(a), np.abs(b))
    if isinstance(op, ast.Gt | ast.GtE):
        a, b = b, a
    over = a - b
    tiny = np.finfo(float).tiny  # a strict comparison of equal sides misses, by nothing to speak of
    if isinstance(op, ast.LtE | ast.GtE):
        return np.where(over <= slack, 0.0, over)
    if isinstance(op, ast.Lt | ast.Gt):
        return np.where(over < -slack, 0.0, np.maximum(over, tiny))
    if isinstance(op, ast.Eq):
        return np.where(np.abs(over) <= slack, 0.0, np.abs(over))
    return np.where(np.abs(over) > slack, 0.0, 1.0)


def _side(tree: ast.expr, names: Mapping[str, object]) -> NDArray[np.generic]:
    if isinstance(tree, ast.Constant) and isinstance(tree.value, str):
        return np.asarray(tree.value)
    if isinstance(tree, ast.Name) and tree.id in names:
        return np.asarray(names[tree.id])
    return np.asarray(evaluate(ast.unparse(tree), names))  # type: ignore[arg-type]
