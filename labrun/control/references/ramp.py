"""From one value to another at a steady rate."""

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field, model_validator

from labrun.control.protocol import Condition
from labrun.toml import Table, TableFaults, checked


class RampSettings(Table):
    """Keys of `ramp`: `from` until `from_s`, then straight to `to`, which it reaches at `to_s` and keeps."""

    start: float = Field(alias="from")
    stop: float = Field(alias="to")
    from_s: float = 0.0
    to_s: float

    @model_validator(mode="after")
    def _ordered(self) -> "RampSettings":
        with TableFaults() as faults:
            if not self.from_s < self.to_s:
                faults.add(
                    "to_s", f"{self.to_s:g} s is not after from_s = {self.from_s:g} s", of=("from_s", "to_s")
                )
        return self


class RampReference:
    """A straight line between two values, held before and after it."""

    Settings: ClassVar[type[Table]] = RampSettings

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:  # noqa: ARG002
        self._keys = checked(RampSettings, settings)

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial."""
        keys = self._keys
        share = (time_s - keys.from_s) / (keys.to_s - keys.from_s)
        return keys.start + min(max(share, 0.0), 1.0) * (keys.stop - keys.start)
