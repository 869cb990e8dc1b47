"""Sinusoidal joints: the gait of most fins."""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun.gaits._keys import Keys, NoSettings, Scope, assemble, check, points, positive_frequency
from labrun.gaits.steering import Driven, Steering
from labrun.spec.experiment import Expression, Value


class SineKeys(Keys):
    """Keys of one sinusoidal joint: numbers, or expressions in the condition's names."""

    offset_deg: Expression = 0.0
    amplitude_deg: Expression
    frequency_hz: Expression
    phase_deg: Expression = 0.0


class SineGait:
    """Each joint moves as ``offset + amplitude * sin(2 pi frequency t + phase)``.

    Eq. 5.1 of the source with one joint; eq. 6.1 with five. Joints are linked by using the same names
    (``amplitude_deg = "-alpha_1"``, eq. 6.2).

    Parameters
    ----------
    joints
        Keys of each joint, see `SineKeys`; angles in degrees, frequencies in Hz.
    let
        Named parts of the expressions.
    settings
        None; the gait has no keys of its own.
    """

    JointKeys: ClassVar[type[Keys]] = SineKeys
    Settings: ClassVar[type[Keys]] = NoSettings
    names: ClassVar[tuple[str, ...]] = ()
    fixed_keys: ClassVar[tuple[str, ...]] = ("frequency_hz",)

    def __init__(
        self,
        joints: Mapping[str, Mapping[str, Expression]],
        let: Mapping[str, Expression],
        settings: Mapping[str, Any],
    ) -> None:
        self._keys: dict[str, SineKeys] = check("sine", SineKeys, joints, settings)
        self._let = let
        self.joints = tuple(joints)

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Expression]]) -> bool:
        """Tell that the motion repeats."""
        return bool(joints)

    def period_s(self, condition: Mapping[str, Value]) -> float | None:
        """Return the time after which all joints repeat; None if their frequencies have no common cycle."""
        scope = Scope(self._let, condition)
        return common_period_s([self._frequency(scope, joint) for joint in self.joints])

    def trajectory(self, condition: Mapping[str, Value], *, duration_s: float, rate_hz: float) -> Trajectory:
        """Return the motion; see `labrun.gaits.protocol.Gait`."""
        scope = Scope(self._let, condition)
        time_s = points(duration_s, rate_hz)
        columns = []
        for joint, keys in self._keys.items():
            offset = scope.number(keys.offset_deg, f"offset_deg of {joint}")
            amplitude = scope.number(keys.amplitude_deg, f"amplitude_deg of {joint}")
            phase = math.radians(scope.number(keys.phase_deg, f"phase_deg of {joint}"))
            angular = 2 * math.pi * self._frequency(scope, joint)
            columns.append(offset + amplitude * np.sin(angular * time_s + phase))
        return assemble(self.joints, time_s, columns, self.period_s(condition))

    def _frequency(self, scope: Scope, joint: str) -> float:
        return positive_frequency(
            scope.number(self._keys[joint].frequency_hz, f"frequency_hz of {joint}"), joint
        )

    def steering(self, condition: Mapping[str, Value], drives: Sequence[str]) -> Steering:
        """Return the angles while offset, amplitude or phase change; see `labrun.gaits.steering.SteerableGait`."""
        driven = Driven(self._let, condition, drives)
        parts = []
        for joint, keys in self._keys.items():
            frequency = driven.number(keys.frequency_hz, f"frequency_hz of {joint}")
            angular = 2 * math.pi * positive_frequency(frequency, joint)
            offset, amplitude = driven.quantity(keys.offset_deg), driven.quantity(keys.amplitude_deg)
            parts.append((angular, offset, amplitude, driven.quantity(keys.phase_deg)))

        def angles(time_s: FloatArray, values: Mapping[str, FloatArray]) -> FloatArray:
            names = driven.names(values)
            found = np.empty((len(time_s), len(parts)))
            for column, (angular, offset, amplitude, phase) in enumerate(parts):
                cycle = np.sin(angular * time_s + np.radians(phase(names)))
                found[:, column] = offset(names) + amplitude(names) * cycle
            return np.radians(found)

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
