"""What a gait is, how a closed loop steers one, and how one is made from its table in the experiment file."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Protocol, cast, runtime_checkable

import numpy as np

from labrun import registry
from labrun.arrays import FloatArray
from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.experiment import Condition, GaitTable
from labrun.toml import Expression, Table, checked, in_order, resolve


class Gait(Protocol):
    """Joint motion as a function of a condition."""

    joints: tuple[str, ...]

    def period_s(self, condition: Condition) -> float | None:
        """Return the length of one cycle; None for a motion that does not repeat."""
        ...

    def trajectory(self, condition: Condition, *, duration_s: float, rate_hz: float) -> Trajectory:
        """Return the motion from 0 to `duration_s`, a point every ``1 / rate_hz`` or a little less; radians.

        Raises
        ------
        SpecError
            The condition gives no motion, for example a negative frequency.
        """
        ...


Steering = Callable[[FloatArray, Mapping[str, FloatArray]], FloatArray]
"""Times of the gait, shape (n,), and each steered variable there, shape (n,), to joint angles, rad, (n, joints)."""


@runtime_checkable
class SteerableGait(Protocol):
    """A gait of which a closed loop sets variables while it runs.

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


@runtime_checkable
class OscillatingGait(Protocol):
    """A gait that knows how often each of its joints repeats, so that trials may be averaged over beats of them."""

    def frequencies_hz(self, condition: Condition) -> Mapping[str, float]:
        """Return the frequency of each joint that has one, Hz.

        Raises
        ------
        SpecError
            A frequency that is not above zero.
        """
        ...


class GaitPlugin(Protocol):
    """The class an entry point of group ``labrun.gaits`` names.

    It may also have `JointKeys` and `Settings` (pydantic models of a joint's keys and of the gait's own keys: the
    loader reports errors in them with line and column), `names` (names it gives to expressions, such as ``t``), and
    `has_cycle(joints)`, which tells whether the motion repeats.
    """

    def __call__(
        self,
        joints: Mapping[str, Mapping[str, float | str]],
        let: Mapping[str, float | str],
        settings: Mapping[str, Any],
    ) -> Gait:
        """Make the gait of numbers and expressions as they stand in the file; SpecError on keys that do not hold."""
        ...


def make_gait(table: GaitTable) -> Gait:
    """Return the gait of an experiment file.

    Raises
    ------
    PluginError
        Unknown plugin, or one that does not import.
    SpecError
        Keys that do not hold.
    """
    plugin = cast("GaitPlugin", registry.load("labrun.gaits", table.plugin))
    joints = {
        joint: {key: expression.given for key, expression in keys.items()}
        for joint, keys in table.joints.items()
    }
    try:
        return plugin(joints, {name: part.given for name, part in table.let.items()}, table.settings)
    # ValueError: a third party's own way of refusing its keys
    except (TypeError, ValueError, SpecError) as error:
        raise SpecError(f'gait "{table.plugin}": {error}') from error


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
                hint="a loop sets the motion within a cycle, not the cycle itself",
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
        angles_rad = np.empty((len(time_s), len(columns)))
        for number, column in enumerate(columns):
            angles_rad[:, number] = column(names)
        return np.radians(angles_rad)

    return angles
