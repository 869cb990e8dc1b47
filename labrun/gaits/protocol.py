"""What a gait is, how a closed loop steers one, and how one is made from its table in the experiment file."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Protocol, cast, runtime_checkable

from labrun import registry
from labrun.arrays import FloatArray
from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.spec import Condition, GaitTable


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
    joints = {joint: {key: one.given for key, one in keys.items()} for joint, keys in table.joints.items()}
    try:
        return plugin(joints, {name: part.given for name, part in table.let.items()}, table.settings)
    except (
        TypeError,
        ValueError,
        SpecError,
    ) as error:  # ValueError: a third party's own way of refusing its keys
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
