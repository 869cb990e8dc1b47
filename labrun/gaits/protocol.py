"""What a gait is, and how one is made from its table in the experiment file."""

from collections.abc import Mapping
from typing import Any, Protocol, cast

from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.spec.experiment import Expression, GaitTable, Value

Condition = Mapping[str, Value]
"""Values of one trial, by name, in the units of the file."""


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


class GaitPlugin(Protocol):
    """The class an entry point of group ``labrun.gaits`` names.

    It may also have `JointKeys` and `Settings` (pydantic models of a joint's keys and of the gait's own keys: the
    loader reports errors in them with line and column), `names` (names it gives to expressions, such as ``t``), and
    `has_cycle(joints)`, which tells whether the motion repeats.
    """

    def __call__(
        self,
        joints: Mapping[str, Mapping[str, Expression]],
        let: Mapping[str, Expression],
        settings: Mapping[str, Any],
    ) -> Gait:
        """Make the gait; raises SpecError on keys that do not hold."""
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
    from labrun import registry

    plugin = cast("GaitPlugin", registry.load("labrun.gaits", table.plugin))
    try:
        return plugin(table.joints, table.let, table.settings)
    except (TypeError, ValueError) as error:  # a third party's own way of refusing its keys
        raise SpecError(f'gait "{table.plugin}": {error}') from error
