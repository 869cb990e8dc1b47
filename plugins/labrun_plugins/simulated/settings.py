"""What every simulated device may be told besides the keys of the real one."""

import os
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat

from labrun.devices import DeviceSettings


class Faults(BaseModel):
    """Bad days on request. Times run from `open`.

    Attributes
    ----------
    stop_answering_after_s
        From then on the device is silent: a sensor sends nothing, an actuator refuses every command.
    nonsense_after_s
        From then on a sensor's values are far outside its range, or not numbers.
    saturate
        A sensor's values all stand at the end of its range.
    drop_share
        Share of a sensor's samples that never arrive, besides those that get lost anyway.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    stop_answering_after_s: NonNegativeFloat | None = None
    nonsense_after_s: NonNegativeFloat | None = None
    saturate: bool = False
    drop_share: float = Field(default=0.0, ge=0.0, le=1.0)


class SimulatedSettings(DeviceSettings):
    """Settings of a simulated device.

    Attributes
    ----------
    faults
        Bad days on request.
    stop_log
        File that gets one line for every stop, so that a test can witness who stopped the motion, and when.
    """

    faults: Faults = Faults()
    stop_log: Path | None = None

    def log_stop(self, device: str, kind: str) -> None:
        """Append process, wall time, device and kind of stop to `stop_log`; never raises."""
        if self.stop_log is None:
            return
        line = f"{os.getpid()} {datetime.now(UTC).isoformat()} {device} {kind}\n"
        try:
            with self.stop_log.open("a", encoding="utf-8") as file:
                file.write(line)
        except OSError:
            pass  # a stop must never fail because its witness cannot write
