"""Sinusoidal joints: the gait of most fins."""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import ClassVar

import numpy as np

from labrun.arrays import FloatArray
from labrun.experiment import Condition
from labrun.gaits.protocol import ExpressionGait, Given, Quantity, Scope, Steering
from labrun.toml import Expression, Table

_ZERO = Expression.of(0.0)


class SineKeys(Table):
    """Keys of one sinusoidal joint: numbers, or expressions in the condition's names."""

    offset_deg: Expression = _ZERO
    amplitude_deg: Expression
    frequency_hz: Expression
    phase_deg: Expression = _ZERO


class SineGait(ExpressionGait):
    """Each joint moves as ``offset + amplitude * sin(2 pi frequency t + phase)``.

    Eq. 5.1 of the source with one joint; eq. 6.1 with five. Joints are linked by using the same names
    (``amplitude_deg = "-alpha_1"``, eq. 6.2). Angles are in degrees, frequencies in Hz.
    """

    JointKeys: ClassVar[type[Table]] = SineKeys
    fixed_keys: ClassVar[tuple[str, ...]] = ("frequency_hz",)

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Given]]) -> bool:
        """Return True: the motion repeats."""
        return bool(joints)

    def period_s(self, condition: Condition) -> float | None:
        """Return the time after which all joints repeat; None if their frequencies have no common cycle."""
        return common_period_s(list(self.frequencies_hz(condition).values()))

    def frequencies_hz(self, condition: Condition) -> dict[str, float]:
        """Return how often each joint repeats."""
        scope = Scope(self._let, condition)
        return {joint: scope.frequency(keys.frequency_hz, joint) for joint, keys in self._keys.items()}

    def steering(self, condition: Condition, drives: Sequence[str]) -> Steering:
        """Return the angles while offset, amplitude or phase change; see `labrun.gaits.SteerableGait`."""
        return self._angles(condition, drives)

    def _angles(self, condition: Condition, drives: Sequence[str]) -> Steering:
        scope = Scope(self._let, condition, drives)
        parts: list[tuple[float, Quantity, Quantity, Quantity]] = []
        for joint, keys in self._keys.items():
            angular = 2 * math.pi * scope.frequency(keys.frequency_hz, joint)
            offset, amplitude = scope.quantity(keys.offset_deg), scope.quantity(keys.amplitude_deg)
            parts.append((angular, offset, amplitude, scope.quantity(keys.phase_deg)))

        def angles(time_s: FloatArray, values: Mapping[str, FloatArray]) -> FloatArray:
            names = scope.at(values)
            angles_rad = np.empty((len(time_s), len(parts)))
            for column, (angular, offset, amplitude, phase) in enumerate(parts):
                cycle = np.sin(angular * time_s + np.radians(phase(names)))
                angles_rad[:, column] = offset(names) + amplitude(names) * cycle
            return np.radians(angles_rad)

        return angles


def common_period_s(frequencies_hz: list[float]) -> float | None:
    """Return the shortest time in which every frequency makes whole cycles.

    Frequencies count as multiples of each other if they are so to 1e-9; None if no ratio of numbers up to 100 fits.
    """
    first = frequencies_hz[0]
    common = Fraction(1)
    for frequency in frequencies_hz[1:]:
        ratio = Fraction(frequency / first).limit_denominator(100)
        if ratio == 0 or abs(float(ratio) * first - frequency) > 1e-9 * frequency:
            return None
        common = Fraction(
            math.gcd(common.numerator, ratio.numerator), math.lcm(common.denominator, ratio.denominator)
        )
    return 1.0 / (first * float(common))
