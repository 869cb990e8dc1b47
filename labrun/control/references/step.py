"""From one value to another at once."""

from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.control.protocol import Condition
from labrun.toml import Table, checked


class StepSettings(Table):
    """Keys of `step`: the value before `at_s`, and from then on."""

    before: float
    after: float
    at_s: float


class StepReference:
    """One value before a time, another from then on."""

    Settings: ClassVar[type[Table]] = StepSettings

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        self._keys = checked(StepSettings, settings)

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        return self._keys.after if time_s >= self._keys.at_s else self._keys.before
