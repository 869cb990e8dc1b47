"""The plant a controller is designed for: fitted from the run first, or given."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from labrun.errors import FitError, RequestError
from labrun.fit.estimate import Estimate
from labrun.fit.summary import FitSummary, FittedData
from labrun.fit.transfer.transfer import Transfer
from labrun.nearest import nearest

if TYPE_CHECKING:
    from labrun.fit.method import FitJob
    from labrun.fit.tuning.settings import PidSettings

_QUANTILE = 1.959964
"""Half-width of a 95 % interval over the standard deviation."""
_NUMBERS = ("gain", "lag_s", "dead_s", "numerator", "denominator")
_INTERVAL = "_ci95"
_TRIES = 20


@dataclass(frozen=True, slots=True)
class Plant:
    """A plant, and how well it is known.

    Attributes
    ----------
    response
        Its name.
    transfer
        What the controller is designed on.
    data
        What it was fitted to.
    plants
        Others that the data do not tell apart from it; none if it was given.
    parameters
        Its numbers with their intervals, as the fit names them.
    warnings
        Of the fit.
    rmse
        Of the response, in the output's unit; None if it was given.
    """

    response: str
    transfer: Transfer
    data: FittedData
    plants: tuple[Transfer, ...] = ()
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    rmse: float | None = None


def find_plant(job: "FitJob", settings: "PidSettings") -> Plant:
    """Return the plant that settings name: given, or fitted by another fit, whose settings the run's experiment has.

    Raises
    ------
    RequestError
        No such response, or settings of the fit that do not hold.
    FitError
        The response cannot be fitted.
    """
    from labrun.fit.method import make_method
    from labrun.fit.run_fit import plan_of

    if settings.given_plant is not None:
        given = settings.given_plant
        units = {"input_unit": given.input_unit, "output_unit": given.output_unit}
        transfer = Transfer.first_order(given.gain, given.lag_s, given.dead_s, **units)
        return Plant(settings.response or "given", transfer, FittedData(Path(job.target).stem, "run", 0))
    plan = plan_of(job.target, Path(), need_model=False)
    keys = {**plan.settings_of(settings.plant), **settings.plant_settings}
    fitted = make_method(settings.plant, keys)(job)
    if not isinstance(fitted, FitSummary):
        raise FitError(f"the fit {settings.plant} gives no transfer functions to design a controller on")
    return plant_of(fitted, settings.response, settings.resamples, job.rng)


def plant_of(fitted: FitSummary, response: str | None, resamples: int, rng: np.random.Generator) -> Plant:
    """Return a response of a fit as a plant, with others within its intervals.

    Parameters
    ----------
    fitted
        Of fit ``fopdt`` or ``transfer-function``: one of its files has a table for each response.
    response
        Which; the first, if None.
    resamples
        How many other plants.

    Raises
    ------
    RequestError
        There is no such response.
    FitError
        The fit gave none at all.
    """
    tables = _tables(fitted)
    name = chosen(list(tables), response)
    transfer = _transfer(tables[name])
    ours = {key: one for key, one in fitted.parameters.items() if name in key} or dict(fitted.parameters)
    # warnings that name another response say nothing about this one
    others = [one for one in tables if one != name]
    told = [one for one in fitted.warnings if not any(other in one for other in others) or name in one]
    plants = _resampled(fitted, name, resamples) or _within(tables[name], resamples, rng)
    if not plants:
        told.append("the fit gives no intervals: margins are those of the fitted plant only")
    return Plant(name, transfer, fitted.data, plants, ours, tuple(told), fitted.rmse.get(name))


def chosen(names: Sequence[str], wanted: str | None) -> str:
    """Return which response is meant.

    Raises
    ------
    RequestError
        There is none of that name.
    """
    if wanted is None:
        return names[0]
    if wanted in names:
        return wanted
    near = nearest(wanted, list(names))
    hint = f"did you mean response={near}?" if near else f"fitted were {', '.join(names)}"
    raise RequestError(f"no response {wanted!r} was fitted", hint=hint)


def cycle_of(job: "FitJob") -> float | None:
    """Return the length of the gait's cycle in a run's trials, s; None if it has none or they differ."""
    from labrun.store.reading import open_run
    from labrun.store.recording import is_recording

    if is_recording(job.target):
        return None
    values = sorted({one.period_s for one in open_run(job.target).outcomes if one.period_s})
    return values[0] if values and values[-1] <= values[0] * (1 + 1e-6) else None


def _resampled(fitted: FitSummary, name: str, count: int) -> tuple[Transfer, ...]:
    """Return a fit's own resamples, those that settle: their numbers belong together."""
    from labrun.fit.transfer.summary import TransferSummary

    if not isinstance(fitted, TransferSummary):
        return ()
    settling = [
        one for one in fitted.resampled.get(name, ()) if one.is_stable and one.gain and one.dead_s >= 0
    ]
    return tuple(settling[:count])


def _tables(fitted: FitSummary) -> dict[str, dict[str, Any]]:
    for name, text in fitted.files.items():
        if not name.endswith(".toml"):
            continue
        read = tomllib.loads(text)
        tables = {key: value for key, value in read.items() if isinstance(value, dict)}
        if tables:
            return tables
        if "dead_s" in read:
            return {Path(name).stem: read}
    raise FitError(f"the fit {fitted.method} gave no transfer function to design a controller on")


def _transfer(table: Mapping[str, Any]) -> Transfer:
    known = {key: value for key, value in table.items() if key.endswith(("_name", "_unit"))}
    dead_s = float(table.get("dead_s", 0.0))
    if "denominator" in table:
        return Transfer(tuple(table["numerator"]), tuple(table["denominator"]), dead_s, **known)
    return Transfer.first_order(float(table["gain"]), float(table["lag_s"]), dead_s, **known)


def _within(table: Mapping[str, Any], count: int, rng: np.random.Generator) -> tuple[Transfer, ...]:
    """Return plants whose numbers are spread as their 95 % intervals say, each on its own; those that settle."""
    if not any(f"{key}{_INTERVAL}" in table for key in _NUMBERS):
        return ()
    found: list[Transfer] = []
    for _ in range(_TRIES * count):
        moved = dict(table)
        for key in _NUMBERS:
            if key in table and f"{key}{_INTERVAL}" in table:
                moved[key] = _moved(table[key], table[f"{key}{_INTERVAL}"], rng)
        moved["dead_s"] = max(float(moved.get("dead_s", 0.0)), 0.0)
        if "lag_s" in moved and moved["lag_s"] <= 0:
            continue
        plant = _transfer(moved)
        if plant.is_stable and plant.gain != 0.0:
            found.append(plant)
        if len(found) == count:
            break
    return tuple(found)


def _moved(value: Any, interval: Any, rng: np.random.Generator) -> Any:
    """Return a number drawn from two half normals, so that its 95 % interval is this one; of lists, each its own."""
    if isinstance(value, list):
        if len(value) != len(interval):
            return value
        return [_moved(one, ends, rng) for one, ends in zip(value, interval, strict=True)]
    low, high = cast("Sequence[float]", interval)
    deviate = float(rng.standard_normal())
    half = (high - value) if deviate > 0 else (value - low)
    return float(value) + deviate * max(half, 0.0) / _QUANTILE
