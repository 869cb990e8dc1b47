"""Which conditions may run: the constraints of a file, and the limits of the rig; and what breaking them costs."""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.devices import Excess
from labrun.errors import RequestError, SpecError
from labrun.experiment import CmaEs, Condition, Penalty
from labrun.toml import Expression, ExpressionError, KeyPath, dotted, evaluate

_TOLERANCE = 1e-9
"""Relative: 60 * 1.4 <= 84 holds whatever the last bit of the product is."""


@dataclass(frozen=True)
class Constraint:
    """One `where` expression: comparisons, joined by `and`, `or` and `not` (chains such as ``0 < a < b`` included).

    Attributes
    ----------
    text
        The expression as the file has it.
    key
        Where in the file that is, such as ``("sweep", "where", 0)``.

    Raises
    ------
    SpecError
        The text is no comparison, or not of the language.
    """

    text: str
    key: KeyPath = ()

    def __post_init__(self) -> None:
        if not Expression.of(self.text).is_comparison:
            raise SpecError(
                f"constraint {self.text!r} is not a comparison",
                hint='a constraint compares two expressions: "a + abs(b) <= 60", also with and, or, not',
            )

    def holds(self, names: Mapping[str, object]) -> NDArray[np.bool_]:
        """Tell where the constraint holds; arrays of names give an array, numbers an array of no dimension."""
        return np.asarray(self.violation(names) == 0.0)

    def violation(self, names: Mapping[str, object]) -> FloatArray:
        """Return by how much the two sides miss the comparison: 0 where it holds, positive elsewhere.

        In the unit of the expression's sides. Under `and` the misses add up, under `or` the least one counts.
        Words that are not equal (or must not be) miss by 1, and so does what `not` denies.

        Raises
        ------
        ConstraintError
            It cannot be computed there, for example because a root of something negative is not a number.
        """
        try:
            return np.asarray(_violation(Expression.of(self.text).tree, names), dtype=float)
        except ExpressionError as error:
            raise ConstraintError(self, str(error)) from error


class ConstraintError(SpecError):
    """A constraint that cannot be computed for the values it has to judge.

    Attributes
    ----------
    key
        Where in the file the constraint stands.
    """

    def __init__(self, constraint: Constraint, reason: str) -> None:
        prefix = f"{dotted(constraint.key)}: " if constraint.key else ""
        super().__init__(
            f"{prefix}constraint {constraint.text!r}: {reason}",
            hint="a constraint needs a finite value everywhere in the ranges of what varies",
        )
        self.key = constraint.key


def constraints(texts: Sequence[str], table: str = "") -> list[Constraint]:
    """Return the constraints of a file's `where` list, which stands in `table`."""
    return [Constraint(text, (table, "where", n) if table else ()) for n, text in enumerate(texts)]


def _violation(tree: ast.expr, names: Mapping[str, object]) -> FloatArray:
    if isinstance(tree, ast.BoolOp):
        parts = np.broadcast_arrays(*(_violation(part, names) for part in tree.values))
        combine = np.sum if isinstance(tree.op, ast.And) else np.min
        return np.asarray(combine(np.stack(parts), axis=0), dtype=float)
    if isinstance(tree, ast.UnaryOp):
        return np.where(_violation(tree.operand, names) == 0.0, 1.0, 0.0)
    assert isinstance(tree, ast.Compare)  # noqa: S101  (a comparison is nothing else)
    sides = [tree.left, *tree.comparators]
    misses = [
        _miss(op, left, right, names) for op, left, right in zip(tree.ops, sides, sides[1:], strict=False)
    ]
    return np.asarray(sum(misses), dtype=float)


def _miss(op: ast.cmpop, left: ast.expr, right: ast.expr, names: Mapping[str, object]) -> FloatArray:
    first, other = _side(left, names), _side(right, names)
    if not (np.issubdtype(first.dtype, np.number) and np.issubdtype(other.dtype, np.number)):
        equal = np.asarray(first == other)
        return np.asarray(equal if isinstance(op, ast.NotEq) else ~equal, dtype=float)
    a, b = first.astype(float), other.astype(float)
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


LimitExcesses = Callable[[Condition], Sequence[Excess]]

_PROBES = 1024


@dataclass(frozen=True, slots=True)
class Violations:
    """What a candidate breaks: how many constraints and limits, how far in all, and which."""

    number: int = 0
    size: float = 0.0
    texts: tuple[str, ...] = ()

    @property
    def feasible(self) -> bool:
        """Tell whether the candidate may run."""
        return self.number == 0


class Feasibility:
    """Checks candidates against the search's `where` and against every limit of the rig.

    Sizes are relative, so that they add up: a `where` by its largest violation found in the
    search space, a limit by its bound.

    Parameters
    ----------
    search
        Its variables and its `where`.
    limit_excesses
        Returns which limits of the rig a condition's motion would leave.
    """

    def __init__(self, search: CmaEs, limit_excesses: LimitExcesses) -> None:
        self._search = search
        self._limits = limit_excesses
        self._where = constraints(search.where, "cmaes")

    def of(self, conditions: Sequence[Condition]) -> list[Violations]:
        """Return what each condition violates; nothing is moved to find out."""
        if not conditions:
            return []
        columns = {
            name: np.array([c[name] for c in conditions], dtype=float) for name in self._search.variables
        }
        misses = [np.broadcast_to(item.violation(columns), (len(conditions),)) for item in self._where]
        return [
            self._of_one(condition, [float(miss[index]) for miss in misses])
            for index, condition in enumerate(conditions)
        ]

    def _of_one(self, condition: Condition, misses: Sequence[float]) -> Violations:
        sizes, texts = [], []
        for constraint, miss, scale in zip(self._where, misses, self._scales, strict=True):
            if miss > 0:
                sizes.append(miss / scale)
                texts.append(constraint.text)
        for size, text in self._limit_excesses(condition, already_out=bool(sizes)):
            sizes.append(size)
            texts.append(text)
        return Violations(len(sizes), float(sum(sizes)), tuple(texts))

    def _limit_excesses(self, condition: Condition, *, already_out: bool) -> list[tuple[float, str]]:
        try:
            excesses = self._limits(condition)
        except RequestError:
            # A gait need not be computable where a constraint forbids it, but must be where it may run.
            if already_out:
                return []
            raise
        return [(abs(e.value - e.bound) / (abs(e.bound) or 1.0), str(e)) for e in excesses]

    @cached_property
    def _scales(self) -> list[float]:
        columns = probes(self._search, _PROBES)
        return [float(np.max(item.violation(columns))) or 1.0 for item in self._where]


def probes(search: CmaEs, count: int) -> dict[str, FloatArray]:
    """Return `count` (a power of two) Sobol points that fill the search space evenly, a column a variable."""
    from scipy.stats import qmc

    variables = search.variables
    lower = [float(variable.start) for variable in variables.values()]
    upper = [float(variable.stop) for variable in variables.values()]
    points = qmc.scale(qmc.Sobol(len(variables), scramble=False).random(count), lower, upper)
    return {name: points[:, index] for index, name in enumerate(variables)}


def penalised(
    costs: Sequence[float | None],
    violations: Sequence[Violations],
    penalty: Penalty,
    *,
    seen: tuple[float, float] | None,
) -> list[float]:
    """Return the cost of every candidate of a generation.

    Parameters
    ----------
    costs
        Measured cost of each candidate (lower is better); None if it did not run or no trial was accepted.
    violations
        Of each candidate.
    penalty
        An infeasible candidate costs ``worst + spread * (per_violation * number + per_size * size)``, where worst and
        spread (largest less smallest) are those of the generation's measured costs: behind all that ran, and
        the further behind the more it violates. A feasible one without an accepted trial costs ``worst``.
    seen
        Smallest and largest cost of all earlier generations, used if nothing of this one was measured.
    """
    measured = [cost for cost in costs if cost is not None]
    low, high = (min(measured), max(measured)) if measured else (seen or (0.0, 0.0))
    spread = high - low or abs(high) or 1.0
    return [
        cost
        if cost is not None
        else high + spread * (penalty.per_violation * item.number + penalty.per_size * item.size)
        for cost, item in zip(costs, violations, strict=True)
    ]
