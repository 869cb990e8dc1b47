"""Joints that follow a formula in time: modulated gaits, steps, ramps."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from labrun.errors import SpecError
from labrun.experiment import Condition
from labrun.gaits.protocol import ExpressionGait, Given, Scope, Steering, in_columns
from labrun.gaits.sine import common_period_s
from labrun.toml import Expression, Table


class FormulaKeys(Table):
    """Keys of one joint: its angle, and how often the motion repeats, if it does."""

    angle_deg: Expression
    frequency_hz: Expression | None = None


class FormulaGait(ExpressionGait):
    """Each joint moves as its formula in ``t`` (s from the start of the motion), the condition's names, and `let`.

    Trigonometric functions take radians; the angle comes out in degrees. Eq. 5.3 of the source is
    ``b + a*sin(2*pi*1.4*t)`` with ``b`` and ``a`` given in `let`.
    """

    JointKeys: ClassVar[type[Table]] = FormulaKeys
    names: ClassVar[tuple[str, ...]] = ("t",)
    fixed_keys: ClassVar[tuple[str, ...]] = ("frequency_hz",)

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Given]]) -> bool:
        """Tell whether a frequency says how often the motion repeats."""
        return any("frequency_hz" in keys for keys in joints.values())

    def period_s(self, condition: Condition) -> float | None:
        """Return the cycle that the joints' `frequency_hz` share; None where none is given."""
        frequencies = list(self.frequencies_hz(condition).values())
        return common_period_s(frequencies) if frequencies else None

    def frequencies_hz(self, condition: Condition) -> dict[str, float]:
        """Return how often each joint repeats that says so."""
        return self._frequencies(Scope(self._let, condition, ("t",)))

    def steering(self, condition: Condition, drives: Sequence[str]) -> Steering:
        """Return the angles while names of the formulas change; see `labrun.gaits.SteerableGait`."""
        return self._angles(condition, drives)

    def _angles(self, condition: Condition, drives: Sequence[str]) -> Steering:
        if "t" in condition:
            raise SpecError('a condition cannot be named "t": a formula calls time by that name')
        scope = Scope(self._let, condition, (*drives, "t"))
        self._frequencies(scope)
        return in_columns([scope.quantity(keys.angle_deg) for keys in self._keys.values()], scope)

    def _frequencies(self, scope: Scope) -> dict[str, float]:
        return {
            joint: scope.frequency(keys.frequency_hz, joint)
            for joint, keys in self._keys.items()
            if keys.frequency_hz is not None
        }
