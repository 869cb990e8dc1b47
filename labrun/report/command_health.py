"""How evenly commands went out, from what the journal holds of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class CommandHealth:
    """One device's commands over the recordings of a run.

    Attributes
    ----------
    device
        Which.
    rate_hz
        Asked for.
    sent, missed
        Set-points sent, and those skipped because their successor was due already.
    late_median_s, late_p99_s
        From when a set-point was due to when its sending began: the median over trials of each trial's own figure.
    late_worst_s
        The greatest of all.
    """

    device: str
    rate_hz: float
    sent: int
    missed: int
    late_median_s: float
    late_p99_s: float
    late_worst_s: float


def command_health(events: Sequence[Mapping[str, Any]]) -> list[CommandHealth]:
    """Return how evenly each device's commands went out; empty for a run whose devices do not tell."""
    by_device: dict[str, list[Mapping[str, Any]]] = {}
    for event in events:
        if event["event"] == "commands" and event["sent"]:
            by_device.setdefault(event["device"], []).append(event)
    return [
        CommandHealth(
            device,
            rate_hz=told[0]["rate_hz"],
            sent=sum(event["sent"] for event in told),
            missed=sum(event["missed"] for event in told),
            late_median_s=float(np.median([event["late_median_s"] for event in told])),
            late_p99_s=float(np.median([event["late_p99_s"] for event in told])),
            late_worst_s=max(event["late_worst_s"] for event in told),
        )
        for device, told in by_device.items()
    ]
