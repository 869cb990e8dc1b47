"""Held at an angle, then let go: free decay."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from labrun.devices import Trajectory
from labrun.gaits._keys import Keys, NoSettings, Scope, assemble, check, points
from labrun.spec.experiment import Expression, Value


class AngleKeys(Keys):
    """Key of one joint that is held: its angle."""

    angle_deg: Expression


class ReleaseGait:
    """Hold each joint at an angle until the recording starts, then let it go.

    The commanded angle is that of the release throughout: whoever holds the body (a person, a magnet) takes it to the
    first point, and lets go when the motion starts. What the body then does is measured, not commanded. Source: the
    hinge pendulum of section 3.

    Parameters
    ----------
    joints
        ``angle_deg`` of each joint.
    let
        Named parts of the expressions.
    settings
        None; the gait has no keys of its own.
    """

    JointKeys: ClassVar[type[Keys]] = AngleKeys
    Settings: ClassVar[type[Keys]] = NoSettings
    names: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        joints: Mapping[str, Mapping[str, Expression]],
        let: Mapping[str, Expression],
        settings: Mapping[str, Any],
    ) -> None:
        self._keys: dict[str, AngleKeys] = check(self._name(), AngleKeys, joints, settings)
        self._let = let
        self.joints = tuple(joints)

    @classmethod
    def _name(cls) -> str:
        return "release"

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Expression]]) -> bool:  # noqa: ARG004
        """Tell that there is no cycle to count."""
        return False

    def period_s(self, condition: Mapping[str, Value]) -> float | None:  # noqa: ARG002
        """Return None: the motion does not repeat."""
        return None

    def trajectory(self, condition: Mapping[str, Value], *, duration_s: float, rate_hz: float) -> Trajectory:
        """Return the angle, constant over the whole duration; see `labrun.gaits.protocol.Gait`."""
        scope = Scope(self._let, condition)
        time_s = points(duration_s, rate_hz)
        angles = [scope.number(keys.angle_deg, f"angle_deg of {joint}") for joint, keys in self._keys.items()]
        return assemble(self.joints, time_s, [np.full(len(time_s), angle) for angle in angles], None)
