"""Gaits of which a closed loop sets a variable while they run."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

from labrun.devices import FloatArray
from labrun.errors import SpecError
from labrun.gaits.protocol import Condition
from labrun.spec.experiment import Expression
from labrun.toml import evaluate, in_order, names_in, resolve

Steering = Callable[[FloatArray, Mapping[str, FloatArray]], FloatArray]
"""Times of the gait, shape (n,), and each steered variable there, shape (n,), to joint angles, rad, (n, joints)."""


@runtime_checkable
class SteerableGait(Protocol):
    """A gait that can be steered.

    `fixed_keys` are keys of a joint that must not depend on a steered variable: the loop sets how the joint moves
    within its cycle, and the cycle itself goes on.
    """

    joints: tuple[str, ...]
    fixed_keys: ClassVar[tuple[str, ...]]

    def steering(self, condition: Condition, drives: Sequence[str]) -> Steering:
        """Return what gives the joint angles while `drives` change; the condition does not name them.

        Raises
        ------
        SpecError
            A key that must not depend on a steered variable does.
        """
        ...


def steering_of(gait: Any, plugin: str, condition: Condition, drives: Sequence[str]) -> Steering:
    """Return the steering of a gait.

    Raises
    ------
    SpecError
        It cannot be steered.
    """
    if not isinstance(gait, SteerableGait):
        raise SpecError(
            f'gait "{plugin}" cannot be steered by a loop',
            hint="formula, hold and sine can; or give it steering()",
        )
    return gait.steering(condition, drives)


class Driven:
    """Expressions of which some change with the steered variables, or with time; the others are computed once.

    Parameters
    ----------
    let
        Named parts of the expressions.
    condition
        Values that stay.
    moving
        Names whose values come later, as arrays.
    """

    def __init__(self, let: Mapping[str, Expression], condition: Condition, moving: Sequence[str]) -> None:
        self._moving = set(moving)
        later: list[str] = []
        for name in in_order(let):
            if names_in(let[name]) & self._moving:
                self._moving.add(name)
                later.append(name)
        self._later = [(name, let[name]) for name in later]
        self._fixed = resolve(
            {name: item for name, item in let.items() if name not in self._moving}, condition
        )

    def names(self, values: Mapping[str, FloatArray]) -> dict[str, Any]:
        """Return everything an expression may name, while the moving ones have these values, shape (n,)."""
        known: dict[str, Any] = {**self._fixed, **values}
        for name, expression in self._later:
            known[name] = evaluate(expression, known)
        return known

    def quantity(self, expression: Expression) -> Callable[[Mapping[str, Any]], FloatArray | float]:
        """Return what computes an expression from `names`."""
        if not names_in(expression) & self._moving:
            value = evaluate(expression, self._fixed)
            return lambda _: value
        text = str(expression).strip()
        if text.isidentifier():  # nearly always the variable as it stands: no need to parse it at every step
            return lambda names: names[text]
        return lambda names: evaluate(text, names)

    def number(self, expression: Expression, what: str) -> float:
        """Return the value of what must not move; an error names `what` it is for."""
        moving = sorted(names_in(expression) & self._moving)
        if moving:
            raise SpecError(
                f"{what} = {expression!r} depends on {', '.join(moving)}, which a loop or time changes",
                hint="a loop sets how a joint moves within its cycle; the cycle itself goes on",
            )
        return float(evaluate(expression, self._fixed))
