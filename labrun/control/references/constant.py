"""One value all the time."""

from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.control.protocol import Condition
from labrun.toml import Table, checked


class ConstantSettings(Table):
    """Key of `constant`: its value."""

    value: float


class ConstantReference:
    """The same value all the time."""

    Settings: ClassVar[type[Table]] = ConstantSettings

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        self._value = checked(ConstantSettings, settings).value

    def __call__(self, time_s: float) -> float:  # noqa: ARG002
        """Return the value."""
        return self._value
