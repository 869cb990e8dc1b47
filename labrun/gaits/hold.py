"""A constant pose, or one that a loop sets."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from labrun.devices import FloatArray
from labrun.gaits.release import ReleaseGait
from labrun.gaits.steering import Driven, Steering
from labrun.spec.experiment import Value


class HoldGait(ReleaseGait):
    """Hold each joint at its ``angle_deg`` while samples are taken: drag of a pose, a body towed, an axis steered."""

    fixed_keys: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def _name(cls) -> str:
        return "hold"

    def steering(self, condition: Mapping[str, Value], drives: Sequence[str]) -> Steering:
        """Return the angles while a loop sets them; see `labrun.gaits.steering.SteerableGait`."""
        driven = Driven(self._let, condition, drives)
        quantities = [driven.quantity(keys.angle_deg) for keys in self._keys.values()]

        def angles(time_s: FloatArray, values: Mapping[str, FloatArray]) -> FloatArray:
            names = driven.names(values)
            found = np.empty((len(time_s), len(quantities)))
            for column, quantity in enumerate(quantities):
                found[:, column] = quantity(names)
            return np.radians(found)

        return angles
