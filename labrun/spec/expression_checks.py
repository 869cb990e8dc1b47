"""An expression of a file: whether it can be read, and whether its names are known."""

from collections.abc import Iterator

from labrun.spec.expression import ExpressionError, names_in
from labrun.spec.names import suggest
from labrun.spec.problem import Problem
from labrun.toml_positions import KeyPath


def check_expression(expression: object, path: KeyPath, known: list[str]) -> Iterator[Problem]:
    """Yield why an expression cannot be read, or which of its names are not among the known; numbers pass."""
    if not isinstance(expression, str):
        return
    try:
        needed = names_in(expression)
    except ExpressionError as error:
        text = str(error).replace(f'expression "{expression}"', "expression", 1).replace("\n  ", "; ")
        yield Problem(path, text.removeprefix("expression: "), at_value=True)
        return
    for name in sorted(needed - set(known)):
        yield Problem(path, f'unknown name "{name}"; {suggest(name, known, kind="names")}', at_value=True)
