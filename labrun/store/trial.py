"""What one trial leaves behind: its outcome, its streams, and how the bench came to rest before it."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from labrun.devices.samples import Channel, FloatArray

Role = Literal["measure", "reference", "fresh", "confirm"]
Status = Literal["done", "rejected", "failed"]


def json_ready(value: Any) -> Any:
    """Turn what numpy makes into what JSON knows (the `default` of `json.dumps`)."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} cannot be stored as JSON")


@dataclass(frozen=True, slots=True)
class Stream:
    """All samples of one device in one trial.

    Attributes
    ----------
    name
        The device's name in the experiment file.
    channels
        What was measured, one a column of `values`.
    time_s : (n,)
        Strictly increasing, from the start of the trial: device time mapped to the run's clock.
    device_time_s, host_time_s : (n,)
        The two times of every sample as they came, never altered.
    values : (n, channels)
        SI units, as measured (not tared).
    rate_hz
        Nominal sample rate.
    lost, saturated
        Number of samples that never arrived, and that stood at the end of the measuring range.
    tare
        Offset found before the recording, by channel name, in the channel's unit.
    """

    name: str
    channels: tuple[Channel, ...]
    time_s: FloatArray
    device_time_s: FloatArray
    host_time_s: FloatArray
    values: FloatArray
    rate_hz: float
    lost: int = 0
    saturated: int = 0
    tare: Mapping[str, float] = field(default_factory=dict)

    def column(self, channel: str) -> FloatArray:
        """Return the values of one channel, shape (n,); KeyError if there is none of that name."""
        for number, known in enumerate(self.channels):
            if known.name == channel:
                return self.values[:, number]
        raise KeyError(channel)


@dataclass(frozen=True, slots=True)
class SettleSummary:
    """How the bench came to rest before a trial.

    Attributes
    ----------
    reason
        Why the trial went on: ``"quiet"``, ``"timeout"``, ``"time"``.
    duration_s
        How long it took.
    spread, drift
        Last values, in the unit of the channel that was watched; None where nothing was watched.
    bound
        What they had to stay below.
    """

    reason: str
    duration_s: float
    spread: float | None = None
    drift: float | None = None
    bound: float | None = None
    channel: str | None = None


@dataclass(frozen=True, slots=True)
class SettleCurve:
    """Spread and drift of the watched channel while the bench settled.

    Attributes
    ----------
    time_s : (n,)
        From the start of settling, increasing.
    spread, drift : (n,)
        In `unit`.
    reason
        Why the trial went on.
    """

    time_s: FloatArray
    spread: FloatArray
    drift: FloatArray
    reason: str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """Everything about a trial but its samples.

    Attributes
    ----------
    index
        Global execution counter of the run, from 0.
    condition
        Names and values, in the units of the experiment file.
    repeat
        Which repeat of its condition this is, from 0.
    reason
        Why it was rejected or failed; empty when done.
    started_s
        The run clock's time at which the trial's `time_s` is zero.
    objectives
        Numbers from the signals; may be incomplete for a failed trial.
    tare
        Offsets by ``"device.channel"``, in the channel's unit.
    checkpoint
        What a resumed run needs to go on from here (clock, scene), JSON-ready.
    attempt
        Which try this is after faults, from 0.
    period_s, discard_cycles
        Length of a gait cycle, and how many of them the objectives leave out.
    """

    index: int
    condition: dict[str, float | str]
    repeat: int
    role: Role = "measure"
    status: Status = "done"
    reason: str = ""
    started_s: float = 0.0
    duration_s: float = 0.0
    objectives: dict[str, float] = field(default_factory=dict)
    tare: dict[str, float] = field(default_factory=dict)
    settle: SettleSummary | None = None
    checkpoint: dict[str, Any] | None = None
    attempt: int = 0
    period_s: float | None = None
    discard_cycles: int = 0

    def to_json(self) -> str:
        """Return the whole outcome as one line of JSON; floats come back bit for bit."""
        data = {name: getattr(self, name) for name in self.__slots__}
        data["settle"] = None if self.settle is None else asdict(self.settle)
        return json.dumps(data, default=json_ready)

    @classmethod
    def from_json(cls, text: str) -> "TrialOutcome":
        """Take back what `to_json` gave."""
        data = json.loads(text)
        settle = data.pop("settle")
        return cls(settle=None if settle is None else SettleSummary(**settle), **data)

    def marked(self, status: Status, reason: str) -> "TrialOutcome":
        """Return the outcome with another status."""
        return replace(self, status=status, reason=reason)
