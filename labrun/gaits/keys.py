"""What the built-in gaits share: checked keys, values of their expressions, and the times of the points."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from labrun.arrays import FloatArray
from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.gaits.protocol import Steering
from labrun.spec import Condition
from labrun.toml import Expression, Table, checked, in_order, resolve

Given = float | str
"""A number or an expression, as it stands in the file."""
Quantity = Callable[[Mapping[str, Any]], FloatArray | float]
"""From what the names stand for to an angle or a frequency."""


class NoGaitKeys(Table):
    """A gait without keys of its own."""


class ExpressionGait(ABC):
    """A gait whose joints move as expressions of their keys say.

    Parameters
    ----------
    joints
        Keys of each joint, see `JointKeys`.
    let
        Named parts of the expressions, which may depend on each other.
    settings
        None; the gait has no keys of its own.

    Raises
    ------
    SpecError
        All keys that do not hold.
    """

    JointKeys: ClassVar[type[Table]]
    Settings: ClassVar[type[Table]] = NoGaitKeys
    names: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self, joints: Mapping[str, Mapping[str, Given]], let: Mapping[str, Given], settings: Mapping[str, Any]
    ) -> None:
        checked(NoGaitKeys, settings, ("gait",))
        self._keys: dict[str, Any] = {
            joint: checked(self.JointKeys, keys, ("gait", "joints", joint)) for joint, keys in joints.items()
        }
        self._let = {name: Expression.of(part) for name, part in let.items()}
        self.joints = tuple(joints)

    @abstractmethod
    def period_s(self, condition: Condition) -> float | None:
        """Return the length of one cycle; None for a motion that does not repeat."""

    @abstractmethod
    def _angles(self, condition: Condition, drives: Sequence[str]) -> Steering:
        """Return what gives the joint angles while `drives` change."""

    def trajectory(self, condition: Condition, *, duration_s: float, rate_hz: float) -> Trajectory:
        """Return the motion; see `labrun.gaits.Gait`."""
        if not (duration_s > 0 and math.isfinite(duration_s)):
            raise SpecError(f"a motion of {duration_s:g} s has no duration")
        # The tolerance keeps 5 s at 100 Hz at 500 steps, whatever the last bit of their product.
        steps = max(1, math.ceil(duration_s * rate_hz * (1 - 1e-12)))
        time_s: FloatArray = np.linspace(0.0, duration_s, steps + 1)
        return Trajectory(
            self.joints, time_s, self._angles(condition, ())(time_s, {}), self.period_s(condition)
        )


class Scope:
    """The names an expression of a gait may use; what does not change is computed once.

    Parameters
    ----------
    let
        Named parts of the expressions.
    condition
        Values that stay.
    moving
        Names whose values come later, as arrays: those that a loop drives, and time.
    """

    def __init__(
        self, let: Mapping[str, Expression], condition: Condition, moving: Sequence[str] = ()
    ) -> None:
        self._moving = set(moving)
        for name in in_order(let):
            if let[name].names.keys() & self._moving:
                self._moving.add(name)
        self._later = {name: let[name] for name in in_order(let) if name in self._moving}
        self._fixed = resolve(
            {name: part for name, part in let.items() if name not in self._moving}, condition
        )

    def at(self, values: Mapping[str, FloatArray]) -> dict[str, Any]:
        """Return everything an expression may name, while the moving ones have these values, shape (n,)."""
        known: dict[str, Any] = {**self._fixed, **values}
        for name, part in self._later.items():
            known[name] = part(known)
        return known

    def quantity(self, expression: Expression) -> Quantity:
        """Return what computes an expression from the names of `at`."""
        if not expression.names.keys() & self._moving:
            value = expression(self._fixed)
            return lambda _: value
        if expression.is_name:  # nearly always the variable as it stands
            return lambda names: names[expression.text.strip()]
        return expression

    def number(self, expression: Expression, what: str) -> float:
        """Return the value of what must not move; an error names `what` it is for."""
        moving = sorted(expression.names.keys() & self._moving)
        if moving:
            raise SpecError(
                f"{what} = {expression.text!r} depends on {', '.join(moving)}, which a loop or time changes",
                hint="a loop sets how a joint moves within its cycle; the cycle itself goes on",
            )
        return float(expression(self._fixed))

    def frequency(self, expression: Expression, joint: str) -> float:
        """Return the frequency of a joint, Hz; SpecError if it is not above zero."""
        value = self.number(expression, f"frequency_hz of {joint}")
        if value <= 0:
            raise SpecError(f"gait.joints.{joint}.frequency_hz is {value:g} Hz; it must be above 0 Hz")
        return value


def in_columns(columns: Sequence[Quantity], scope: Scope) -> Steering:
    """Return the steering of joints whose angle, in degrees, is one quantity each; time is called ``t``."""

    def angles(time_s: FloatArray, values: Mapping[str, FloatArray]) -> FloatArray:
        names = scope.at({**values, "t": time_s})
        found = np.empty((len(time_s), len(columns)))
        for number, column in enumerate(columns):
            found[:, number] = column(names)
        return np.radians(found)

    return angles
