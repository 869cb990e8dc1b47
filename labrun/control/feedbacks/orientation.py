"""A body's orientation as the four numbers of a unit quaternion."""

from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.control.history import History
from labrun.control.protocol import Numbers
from labrun.errors import ExperimentError, SpecError
from labrun.toml import Table, checked

COMPONENTS = ("qw", "qx", "qy", "qz")
_LEAST = 0.1
"""Length below which four numbers are no unit quaternion."""


class OrientationSettings(Table):
    """Keys of `orientation`: `body`, whose channels ``body_qw`` ... ``body_qz`` a tracker gives, as "cameras.horn"."""

    body: str


class OrientationFeedback:
    """The newest orientation of a body that a tracker follows: qw, qx, qy, qz, of length 1 and with qw >= 0.

    A quaternion and its negative are one orientation; within half a turn of the room's own axes qw >= 0 chooses one of
    them without a jump. What has no direction (a tracker that lost the body sends zeros) ends the run.

    Parameters
    ----------
    settings
        See `OrientationSettings`.
    units
        Unit of every channel, by ``device.channel``.

    Raises
    ------
    SpecError
        Keys that do not hold.
    """

    Settings: ClassVar[type[Table]] = OrientationSettings
    several: ClassVar[bool] = True

    def __init__(self, settings: Mapping[str, Any], units: Mapping[str, str]) -> None:
        body = checked(OrientationSettings, settings).body
        self.channels: tuple[str, ...] = tuple(f"{body}_{name}" for name in COMPONENTS)
        self.unit = "1"
        missing = [channel for channel in self.channels if channel not in units]
        if missing:
            raise SpecError(
                f"nothing tells the orientation of {body}: there is no channel {missing[0]}",
                hint='body is the tracker and one of its bodies: "cameras.arm"',
            )

    @staticmethod
    def components(settings: Mapping[str, Any]) -> tuple[str, ...]:  # noqa: ARG004
        """Return the names of the numbers."""
        return COMPONENTS

    def memory_s(self, period_s: float | None) -> float:  # noqa: ARG002
        """Return 0: nothing but the newest counts."""
        return 0.0

    def __call__(self, history: History, period_s: float | None) -> Numbers:  # noqa: ARG002
        """Return the quaternion.

        Raises
        ------
        ExperimentError
            It has no length.
        """
        w, x, y, z = [history.newest(channel)[1] for channel in self.channels]
        return unit_quaternion(w, x, y, z)


def unit_quaternion(w: float, x: float, y: float, z: float) -> Numbers:
    """Return the unit quaternion of an orientation, qw >= 0.

    Raises
    ------
    ExperimentError
        No orientation: all four are next to nothing, or one is no number.
    """
    length = (w * w + x * x + y * y + z * z) ** 0.5
    if not length > _LEAST:
        raise ExperimentError(
            f"the tracker gives no orientation: ({w:g}, {x:g}, {y:g}, {z:g}); it lost the body",
            hint="let it be seen again, then labrun resume",
        )
    length = -length if w < 0.0 else length
    return w / length, x / length, y / length, z / length
