"""Named parts of a gait's formulas: each may use the ones it needs, in any order, but not itself."""

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from labrun.spec.experiment import Expression
from labrun.spec.expression import Array, ExpressionError, Operand, evaluate, names_in


def order(let: Mapping[str, Expression]) -> tuple[str, ...]:
    """Return the names of `let` such that each comes after those it uses.

    Raises
    ------
    ExpressionError
        One that cannot be read, or names that depend on each other in a circle.
    """
    graph = {name: names_in(expression) & let.keys() for name, expression in let.items()}
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        circle = " -> ".join(error.args[1])
        raise ExpressionError(f"let: {circle} go round in a circle") from error


def resolve(let: Mapping[str, Expression], names: Mapping[str, Operand]) -> dict[str, Operand | Array]:
    """Return `names` extended by the values of `let`."""
    known = dict(names)
    for name in order(let):
        known[name] = evaluate(let[name], known)
    return known
