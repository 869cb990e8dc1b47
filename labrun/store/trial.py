"""What one trial leaves behind beside its samples: its outcome, how the bench came to rest, and its row of a table."""

import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

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
    return sum(outcome.truncation.get(objective, 0.0) for outcome in outcomes) / max(len(outcomes), 1)


def settle_curve(time_s: FloatArray, spread: FloatArray, drift: FloatArray, unit: str) -> Signals:
    """Return spread and drift of the watched channel while the bench settled, each of shape (n,), as signals."""
    return Signals(SETTLE, ("spread", "drift"), (unit, unit), time_s, np.column_stack([spread, drift]))


@dataclass(frozen=True, slots=True)
class Variable:
    """One column: a name free of collisions, its unit, and one value a trial (numbers or text)."""

    name: str
    unit: str
    values: NDArray[Any]
    kind: str


HEAD = ("index",)
MIDDLE = ("repeat", "status")
TAIL = (
    "role",
    "reason",
    "started_s",
    "duration_s",
    "settle_reason",
    "settle_duration_s",
    "attempt",
    "period_s",
    "mounting",
    "censored",
    "damage",
)
AXIS = "trial"
"""Dimension of the table."""


def variables(
    outcomes: Sequence[TrialOutcome], units: Mapping[str, str], taken: Collection[str] = ()
) -> list[Variable]:
    """Return the columns of a run.

    Parameters
    ----------
    outcomes
        One a row.
    units
        Of conditions and objectives, by name.
    taken
        Names that stand beside the table, which no column may have.

    Returns
    -------
    list of Variable
        index, conditions, repeat, status, objectives, what cut cycles may have done to them where any were cut, role,
        reason, started_s, duration_s, how the bench settled, attempt, period_s, mounting, censored, damage. A condition
        with words is text throughout. NaN (or empty text) stands where a trial has no such value, as after a failure.
    """
    used = {AXIS, *HEAD, *MIDDLE, *TAIL, *taken}

    def columns(
        of: Literal["condition", "objectives", "truncation"], prefix: str, kind: str
    ) -> list[Variable]:
        entries: list[Mapping[str, Any]] = [getattr(outcome, of) for outcome in outcomes]
        return [
            Variable(
                _free(f"{name}_{of}" if of == "truncation" else name, prefix, used),
                units.get(name, ""),
                _column([entry.get(name) for entry in entries]),
                kind,
            )
            for name in dict.fromkeys(name for entry in entries for name in entry)
        ]

    condition_columns = columns("condition", "condition", "condition")
    objective_columns = columns("objectives", "objective", "objective")
    objective_columns += columns("truncation", "truncation", "trial")
    head, middle, tail = (
        [
            Variable(name, "s" if name.endswith("_s") else "", _of_trials(name, outcomes), "trial")
            for name in names
        ]
        for names in (HEAD, MIDDLE, TAIL)
    )
    return [*head, *condition_columns, *middle, *objective_columns, *tail]


def _of_trials(name: str, outcomes: Sequence[TrialOutcome]) -> NDArray[Any]:
    """Return one value a trial that is neither condition nor objective."""
    if name in ("index", "repeat", "attempt"):
        return np.array([getattr(outcome, name) for outcome in outcomes], dtype=np.int64)
    if name == "settle_reason":
        return _text("" if outcome.settle is None else outcome.settle.reason for outcome in outcomes)
    if name == "settle_duration_s":
        return _column(
            [None if outcome.settle is None else outcome.settle.duration_s for outcome in outcomes]
        )
    values = [getattr(outcome, name) for outcome in outcomes]
    return _text(values) if name in ("status", "role", "reason", "damage") else _column(values)


def known_units(spec_toml: str, channel_units: Mapping[str, str]) -> dict[str, str]:
    """Return the units of conditions and objectives.

    Parameters
    ----------
    spec_toml
        The run's resolved experiment file; its table ``units`` counts first.
    channel_units
        Unit of every recorded channel, by ``"device.channel"``.
    """
    spec = tomllib.loads(spec_toml)
    units: dict[str, str] = {}
    for name, settings in spec.get("objectives", {}).items():
        units[name] = _objective_unit(name, settings, channel_units)
    units.update(spec.get("units", {}))
    return units


def _objective_unit(name: str, settings: Mapping[str, Any], channel_units: Mapping[str, str]) -> str:
    from labrun.errors import LabrunError
    from labrun.experiment import ObjectiveTable
    from labrun.objectives import make_objective

    unit = channel_units.get(str(settings.get("channel", "")), "")
    try:
        return str(make_objective(name, ObjectiveTable(**settings)).unit(unit))
    except (LabrunError, ValueError):
        return ""  # the plugin that made the numbers is no longer installed: they stay readable without their unit


def _free(name: str, kind: str, taken: set[str]) -> str:
    """Return a name that HDF5 accepts and no other column has."""
    free = name.replace("/", "_")
    free = kind if free in ("", ".") else free
    while free in taken:
        free = f"{kind}_{free}"
    taken.add(free)
    return free


def _text(words: Any) -> NDArray[Any]:
    return np.array(list(words), dtype=object)


def _column(values: Sequence[float | str | None]) -> NDArray[Any]:
    if any(isinstance(value, str) for value in values):
        return _text("" if value is None else str(value) for value in values)
    return np.array([np.nan if value is None else value for value in values], dtype=float)
