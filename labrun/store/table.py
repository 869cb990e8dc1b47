"""The table at the root of a packed run: one row a trial, for readers without labrun."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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


def variables(outcomes: Sequence[TrialOutcome], units: Mapping[str, str]) -> list[Variable]:
    """Return the columns of a run.

    Parameters
    ----------
    outcomes
        One a row.
    units
        Of conditions and objectives, by name.

    Returns
    -------
    list of Variable
        index, conditions, repeat, status, objectives, role, reason, started_s, duration_s. A condition with
        words is text throughout. NaN (or empty text) stands where a trial has no such value, as after a failure.
    """
    conditions = list(dict.fromkeys(name for outcome in outcomes for name in outcome.condition))
    objectives = list(dict.fromkeys(name for outcome in outcomes for name in outcome.objectives))
    head = [Variable("index", "", np.array([outcome.index for outcome in outcomes], dtype=np.int64), "trial")]
    middle = [
        Variable("repeat", "", np.array([outcome.repeat for outcome in outcomes], dtype=np.int64), "trial"),
        Variable("status", "", _text(outcome.status for outcome in outcomes), "trial"),
    ]
    tail = [
        Variable("role", "", _text(outcome.role for outcome in outcomes), "trial"),
        Variable("reason", "", _text(outcome.reason for outcome in outcomes), "trial"),
        Variable(
            "started_s", "s", np.array([outcome.started_s for outcome in outcomes], dtype=float), "trial"
        ),
        Variable(
            "duration_s", "s", np.array([outcome.duration_s for outcome in outcomes], dtype=float), "trial"
        ),
    ]
    taken = {"trial", *(variable.name for variable in [*head, *middle, *tail])}
    condition_columns = [
        Variable(
            _free(name, "condition", taken),
            units.get(name, ""),
            _column([outcome.condition.get(name) for outcome in outcomes]),
            "condition",
        )
        for name in conditions
    ]
    objective_columns = [
        Variable(
            _free(name, "objective", taken),
            units.get(name, ""),
            _column([outcome.objectives.get(name) for outcome in outcomes]),
            "objective",
        )
        for name in objectives
    ]
    return [*head, *condition_columns, *middle, *objective_columns, *tail]


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
    from labrun.spec.experiment import ObjectiveTable

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
