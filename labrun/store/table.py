"""The table at the root of a packed run: one row a trial, for readers without labrun."""

import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labrun.store.trial import TrialOutcome


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
                _column([one.get(name) for one in entries]),
                kind,
            )
            for name in dict.fromkeys(name for one in entries for name in one)
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
    found: dict[str, str] = {}
    for name, settings in spec.get("objectives", {}).items():
        found[name] = _objective_unit(name, settings, channel_units)
    found.update(spec.get("units", {}))
    return found


def _objective_unit(name: str, settings: Mapping[str, Any], channel_units: Mapping[str, str]) -> str:
    from labrun.errors import LabrunError
    from labrun.objectives import make_objective
    from labrun.spec import ObjectiveTable

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
