"""Slow motions there and back again: evenly, or in steps with a rest on each."""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import SpecError
from labrun.experiment import Condition
from labrun.gaits.protocol import ExpressionGait, Given, Scope, Steering, in_columns
from labrun.gaits.sine import common_period_s
from labrun.toml import Expression, Table

_WHOLE = 1e-9
"""Relative slack when steps are counted: 1 deg in steps of 0.1 deg are ten, not eleven."""
Way = Callable[[FloatArray], FloatArray]
"""From times, s, to angles, deg."""


class RampKeys(Table):
    """Keys of one joint of a ramp."""

    from_deg: Expression = Expression.of(0)
    to_deg: Expression
    speed_deg_s: Expression


class StaircaseKeys(Table):
    """Keys of one joint of a staircase."""

    from_deg: Expression = Expression.of(0)
    to_deg: Expression
    step_deg: Expression
    hold_s: Expression


class _ThereAndBack(ExpressionGait):
    """From one angle to another and back: one cycle. `_way` says how."""

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Given]]) -> bool:
        """Return True: there and back is one cycle."""
        return bool(joints)

    def period_s(self, condition: Condition) -> float | None:
        """Return how long there and back take; None if the joints have no common cycle."""
        return common_period_s([1.0 / period for _, period in self._ways(condition)])

    def _angles(self, condition: Condition, drives: Sequence[str]) -> Steering:
        scope = Scope(self._let, condition, drives)
        columns = [lambda names, way=way: way(names["t"]) for way, _ in self._ways(condition)]
        return in_columns(columns, scope)

    def _ways(self, condition: Condition) -> list[tuple[Way, float]]:
        """Return each joint's way, and how long it takes there and back."""
        scope = Scope(self._let, condition)
        ways = []
        for joint, keys in self._keys.items():
            values = {
                key: scope.number(getattr(keys, key), f"{key} of {joint}") for key in type(keys).model_fields
            }
            for key, value in values.items():
                if key not in ("from_deg", "to_deg") and not value > 0:
                    raise SpecError(f"gait.joints.{joint}.{key} is {value:g}; it must be above 0")
            if values["from_deg"] == values["to_deg"]:
                raise SpecError(f"gait.joints.{joint} goes from {values['from_deg']:g} deg to where it is")
            ways.append(self._way(values))
        return ways

    @staticmethod
    @abstractmethod
    def _way(values: Mapping[str, float]) -> tuple[Way, float]:
        """Return a joint's way over time, and how long it takes there and back, from its keys."""


class RampGait(_ThereAndBack):
    """Each joint goes at constant speed from ``from_deg`` to ``to_deg``, and back: one cycle.

    A test that ends with the way there takes ``duration_s`` as its length instead of a cycle.
    """

    JointKeys: ClassVar[type[Table]] = RampKeys

    @staticmethod
    def _way(values: Mapping[str, float]) -> tuple[Way, float]:
        start, end = values["from_deg"], values["to_deg"]
        leg_s = abs(end - start) / values["speed_deg_s"]
        return lambda time_s: end + (start - end) * np.abs(time_s % (2 * leg_s) / leg_s - 1.0), 2 * leg_s


class StaircaseGait(_ThereAndBack):
    """Each joint goes in steps of ``step_deg`` to ``to_deg``, rests ``hold_s`` on each, and goes back.

    The last step is shorter where the way is no whole number of steps. A step takes one period of ``command_rate_hz``.
    Source: the steps of 10 um of the curved beam, section 7.2.
    """

    JointKeys: ClassVar[type[Table]] = StaircaseKeys

    @staticmethod
    def _way(values: Mapping[str, float]) -> tuple[Way, float]:
        start, end, hold_s = values["from_deg"], values["to_deg"], values["hold_s"]
        steps = math.ceil(abs(end - start) / values["step_deg"] * (1 - _WHOLE))
        step = math.copysign(values["step_deg"], end - start)

        def way(time_s: FloatArray) -> FloatArray:
            # a point of time that is a whole number of rests belongs to the rest that begins there
            rest = np.floor(time_s / hold_s * (1 + _WHOLE)) % (2 * steps)
            taken = np.minimum(rest, 2 * steps - rest)
            return np.where(taken == steps, end, start + step * taken)

        return way, 2 * steps * hold_s
