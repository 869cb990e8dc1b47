"""The plant a controller is designed for: fitted from the run first, or given."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import FitError, RequestError
from labrun.fit.estimate import Estimate
from labrun.fit.summary import FitSummary, FittedData
from labrun.fit.transfer import TransferFunction
from labrun.toml import nearest

if TYPE_CHECKING:
    from labrun.fit.method import FitJob
    from labrun.fit.tuning.settings import PidSettings


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
    transfer: TransferFunction
    data: FittedData
    plants: tuple[TransferFunction, ...] = ()
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
        transfer = TransferFunction.first_order(given.gain, given.lag_s, given.dead_s, **units)
        return Plant(settings.response or "given", transfer, FittedData(Path(job.target).stem, "run", 0))
    plan = plan_of(job.target, Path(), need_model=False)
    keys = {**plan.settings_of(settings.plant), **settings.plant_settings}
    fitted = make_method(settings.plant, keys)(job)
    if not isinstance(fitted, FitSummary):
        raise FitError(f"the fit {settings.plant} gives no transfer functions to design a controller on")
    return plant_of(fitted, settings.response, settings.resamples)


def plant_of(fitted: FitSummary, response: str | None, resamples: int) -> Plant:
    """Return a response of a fit as a plant, with others that its data do not rule out.

    Parameters
    ----------
    fitted
        Of fit ``fopdt`` or ``transfer-function``.
    response
        Which; the first, if None.
    resamples
        How many other plants, at most.

    Raises
    ------
    RequestError
        There is no such response.
    FitError
        The fit gave none at all.
    """
    from labrun.fit.transfer.summary import TransferSummary

    if not isinstance(fitted, TransferSummary) or not fitted.transfers:
        raise FitError(f"the fit {fitted.method} gave no transfer function to design a controller on")
    name = chosen(list(fitted.transfers), response)
    # warnings that begin with another response say nothing about this one
    others = tuple(f"{one}:" for one in fitted.transfers if one != name)
    told = [one for one in fitted.warnings if not one.startswith(others)]
    plants = _settling(fitted.resampled.get(name, ()))[:resamples]
    if not plants:
        told.append(
            "the fit gives no resampled plants that settle: margins are those of the fitted plant only"
        )
    return Plant(
        name,
        fitted.transfers[name],
        fitted.data,
        plants,
        fitted.estimates.get(name, {}),
        tuple(told),
        fitted.rmse.get(name),
    )


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


def _settling(resampled: Sequence[TransferFunction]) -> tuple[TransferFunction, ...]:
    """Return those of a fit's resamples that can be controlled: their numbers belong together."""
    return tuple(one for one in resampled if one.is_stable and one.gain and one.dead_s >= 0)
