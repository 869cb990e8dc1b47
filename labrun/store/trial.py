"""What one trial leaves behind beside its samples: its outcome, and how the bench came to rest before it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.signals import Signals

Role = Literal["measure", "reference", "fresh", "confirm"]
Status = Literal["done", "rejected", "failed"]
SETTLE = "settle"
"""Name of the signals that tell how the bench came to rest."""


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
class SettleSummary:
    """How the bench came to rest before a trial.

    Attributes
    ----------
    reason
        Why the trial went on: ``"quiet"``, ``"timeout"``, ``"time"``.
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
        What a resumed run needs to go on from here (clock, scene), as the text of a JSON object: whoever reads outcomes
        seldom wants it.
    attempt
        Which try this is after faults, from 0.
    censored
        Whether it reached the most cycles allowed before it came to its end: what was waited for takes longer.
    damage
        What it did to its specimen, such as ``"broken"``; empty where that is as it was.
    mounting
        Which mounting of what is set by hand, counted over the run from 1; None where nothing is.
    truncation
        By objective, a bound of what cycles that its window cuts may have added to it or taken from it, in its unit.
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
    checkpoint: str | None = None
    attempt: int = 0
    period_s: float | None = None
    discard_cycles: int = 0
    mounting: int | None = None
    censored: bool = False
    damage: str = ""
    truncation: dict[str, float] = field(default_factory=dict)

    def to_record(self) -> dict[str, Any]:
        """Return the whole outcome, JSON-ready by `json_ready`; floats come back bit for bit."""
        settle = None if self.settle is None else asdict(self.settle)
        return {**{name: getattr(self, name) for name in self.__slots__}, "settle": settle}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "TrialOutcome":
        """Take back what `to_record` gave."""
        settle = record["settle"]
        return cls(**{**record, "settle": None if settle is None else SettleSummary(**settle)})

    def marked(self, status: Status, reason: str) -> "TrialOutcome":
        """Return the outcome with another status."""
        return replace(self, status=status, reason=reason)

    def corrected(self, objectives: Mapping[str, float]) -> "TrialOutcome":
        """Return the outcome with other values of some objectives."""
        return replace(self, objectives={**self.objectives, **objectives})


def mean_truncation(outcomes: Sequence[TrialOutcome], objective: str) -> float:
    """Return what cut cycles may have done to the mean of an objective over trials; 0 where none were cut."""
    return sum(one.truncation.get(objective, 0.0) for one in outcomes) / max(len(outcomes), 1)


def settle_curve(time_s: FloatArray, spread: FloatArray, drift: FloatArray, unit: str) -> Signals:
    """Return spread and drift of the watched channel while the bench settled, each of shape (n,), as signals."""
    return Signals(SETTLE, ("spread", "drift"), (unit, unit), time_s, np.column_stack([spread, drift]))
