"""Joints held at an angle: let go for a free decay, or held while samples are taken."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from labrun.experiment import Condition
from labrun.gaits.protocol import ExpressionGait, Given, Scope, Steering, in_columns
from labrun.toml import Expression, Table


class AngleKeys(Table):
    """Key of one joint that is held: its angle."""

    angle_deg: Expression


class ReleaseGait(ExpressionGait):
    """Hold each joint at an angle until the recording starts, then let it go.

    The commanded angle is that of the release throughout: whoever holds the body (a person, a magnet) takes it to the
    first point, and lets go when the motion starts. What the body then does is measured, not commanded. Source: the
    hinge pendulum of section 3.
    """

    JointKeys: ClassVar[type[Table]] = AngleKeys

    @staticmethod
    def has_cycle(joints: Mapping[str, Mapping[str, Given]]) -> bool:  # noqa: ARG004
        """Return False: the motion has no cycle."""
        return False

    def period_s(self, condition: Condition) -> float | None:  # noqa: ARG002
        """Return None: the motion does not repeat."""
        return None

    def _angles(self, condition: Condition, drives: Sequence[str]) -> Steering:
        scope = Scope(self._let, condition, drives)
        return in_columns([scope.quantity(keys.angle_deg) for keys in self._keys.values()], scope)


class HoldGait(ReleaseGait):
    """Hold each joint at its ``angle_deg`` while samples are taken: drag of a pose, a body towed, an axis steered."""

    fixed_keys: ClassVar[tuple[str, ...]] = ()

    def steering(self, condition: Condition, drives: Sequence[str]) -> Steering:
        """Return the angles while a loop sets them; see `labrun.gaits.SteerableGait`."""
        return self._angles(condition, drives)
