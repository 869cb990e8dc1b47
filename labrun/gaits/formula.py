"""Joints that follow a formula in time: modulated gaits, steps, ramps."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from labrun.devices import FloatArray, Trajectory
from labrun.errors import SpecError
from labrun.gaits._keys import Keys, NoSettings, Scope, assemble, check, points, positive_frequency
from labrun.gaits.sine import common_period_s
from labrun.gaits.steering import Driven, Steering
from labrun.spec.experiment import Expression, Value
from labrun.toml import names_in


class FormulaKeys(Keys):
    """Keys of one joint: its angle, and how often the motion repeats, if it does."""

    angle_deg: Expression
    frequency_hz: Expression | None = None


class FormulaGait:
    """Each joint moves as its formula in ``t`` (s from the start of the motion), the condition's names, and `let`.

    Trigonometric functions take radians; the angle comes out in degrees. Eq. 5.3 of the source is
    ``b + a*sin(2*pi*1.4*t)`` with ``b`` and ``a`` given in `let`.

    Parameters
    ----------
    joints
        Keys of each joint, see `FormulaKeys`.
    let
        Named parts of the formulas, which may depend on ``t`` and on each other.
    settings
        None; the gait has no keys of its own.
    """

    JointKeys: ClassVar[type[Keys]] = FormulaKeys
    Settings: ClassVar[type[Keys]] = NoSettings
    names: ClassVar[tuple[str, ...]] = ("t",)
    fixed_keys: ClassVar[tuple[str, ...]] = ("frequency_hz",)

    def __init__(
        self,
        joints: Mapping[str, Mapping[str, Expression]],
        let: Mapping[str, Expression],
        settings: Mapping[str, Any],
    ) -> None:
        self._keys: dict[str, FormulaKeys] = check("formula", FormulaKeys, joints, settings)
        self._let = let
        self.joints = tuple(joints)

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Expression]]) -> bool:
        """Tell whether a frequency says how often the motion repeats."""
        return any("frequency_hz" in keys for keys in joints.values())

    def period_s(self, condition: Mapping[str, Value]) -> float | None:
        """Return the cycle that the joints' `frequency_hz` share; None where none is given."""
        scope = Scope(self._timeless(), condition)
        frequencies = [
            positive_frequency(scope.number(keys.frequency_hz, f"frequency_hz of {joint}"), joint)
            for joint, keys in self._keys.items()
            if keys.frequency_hz is not None
        ]
        return common_period_s(frequencies) if frequencies else None

    def trajectory(self, condition: Mapping[str, Value], *, duration_s: float, rate_hz: float) -> Trajectory:
        """Return the motion; see `labrun.gaits.protocol.Gait`."""
        if "t" in condition:
            raise SpecError('a condition cannot be named "t": a formula calls time by that name')
        time_s: FloatArray = points(duration_s, rate_hz)
        scope = Scope(self._let, condition, t=time_s)
        columns = [scope.series(keys.angle_deg, len(time_s)) for keys in self._keys.values()]
        return assemble(self.joints, time_s, columns, self.period_s(condition))

    def steering(self, condition: Mapping[str, Value], drives: Sequence[str]) -> Steering:
        """Return the angles while names of the formulas change; see `labrun.gaits.steering.SteerableGait`."""
        driven = Driven(self._let, condition, (*drives, "t"))
        for joint, keys in self._keys.items():
            if keys.frequency_hz is not None:
                driven.number(keys.frequency_hz, f"frequency_hz of {joint}")
        quantities = [driven.quantity(keys.angle_deg) for keys in self._keys.values()]

        def angles(time_s: FloatArray, values: Mapping[str, FloatArray]) -> FloatArray:
            names = driven.names({**values, "t": time_s})
            found = np.empty((len(time_s), len(quantities)))
            for column, quantity in enumerate(quantities):
                found[:, column] = quantity(names)
            return np.radians(found)

        return angles

    def _timeless(self) -> dict[str, Expression]:
        """Return the parts of `let` that do not change with time, from which a frequency can be computed."""
        moving = {"t"}
        while True:
            more = {name for name, item in self._let.items() if names_in(item) & moving} - moving
            if not more:
                return {name: item for name, item in self._let.items() if name not in moving}
            moving |= more
