"""The fit ``pid``: controllers for a response that is fitted first, or given."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel

from labrun.errors import FitError, RequestError
from labrun.estimate import Estimate
from labrun.fit.method import FitJob, WithSettings, make_method
from labrun.fit.result import FitSummary, FittedData
from labrun.fit.transfer import TransferFunction, TransferSummary
from labrun.fit.tuning import summary as words
from labrun.fit.tuning.designs import Study, as_json, controllers_toml, study
from labrun.fit.tuning.settings import PidFitSettings
from labrun.json_numbers import finite
from labrun.store import is_recording, open_run
from labrun.toml import suggest

_LOOP_NAMES = {"magnitude": "force"}
"""What the loop around a response is called in the experiments that labrun brings along."""


class PidDesign(WithSettings[PidFitSettings]):
    """P, PI and PID, also with a feed-forward, by SIMC and by optimum under margins; predicted before they run."""

    Settings: ClassVar[type[BaseModel]] = PidFitSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit the plant, design controllers for it, and judge them.

        Raises
        ------
        RequestError
            No such response; an average over a cycle without one.
        FitError
            The plant cannot be fitted, or is one that does not settle.
        """
        plant = find_plant(job, self._settings)
        average_s = averaged_over(job, self._settings)
        job.note(f"designing controllers for {plant.response}")
        return summary(plant, study(plant.transfer, plant.plants, self._settings, average_s))


@dataclass(frozen=True, slots=True)
class FittedPlant:
    """A response to design controllers on, and how well it is known.

    Attributes
    ----------
    data
        What it was fitted to.
    plants
        Others that the data do not tell apart from it; none if it was given.
    parameters
        Its numbers with their intervals, as the fit names them.
    rmse
        In the output's unit; None if it was given.
    """

    response: str
    transfer: TransferFunction
    data: FittedData
    plants: tuple[TransferFunction, ...] = ()
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    rmse: float | None = None


def find_plant(job: FitJob, settings: PidFitSettings) -> FittedPlant:
    """Return the plant that settings name: given, or fitted by another fit, whose settings the run's experiment has.

    Raises
    ------
    RequestError
        No such response, or settings of the fit that do not hold.
    FitError
        The response cannot be fitted.
    """
    if settings.given_plant is not None:
        data = FittedData(Path(job.target).stem, "run", 0)
        return FittedPlant(settings.response or "given", TransferFunction.of(settings.given_plant), data)
    keys = {**job.settings_of(settings.plant), **settings.plant_settings}
    return plant_of(make_method(settings.plant, keys)(job), settings.response, settings.resamples)


def plant_of(fitted: FitSummary, response: str | None, resamples: int) -> FittedPlant:
    """Return a response of a fit (the first, if None) as a plant, with some others that its data do not rule out.

    Raises
    ------
    RequestError
        There is no such response.
    FitError
        The fit, not ``fopdt`` or ``transfer-function``, gave none at all.
    """
    if not isinstance(fitted, TransferSummary) or not fitted.transfers:
        raise FitError(f"the fit {fitted.method} gave no transfer function to design a controller on")
    names = list(fitted.transfers)
    name = names[0] if response is None else response
    if name not in names:
        hint = suggest(name, names, kind="fitted responses")
        raise RequestError(f"no response {name!r} was fitted", hint=hint)
    # warnings that begin with another response say nothing about this one
    others = tuple(f"{other}:" for other in names if other != name)
    messages = [warning for warning in fitted.warnings if not warning.startswith(others)]
    # those that can be controlled: their numbers belong together
    resampled = fitted.resampled.get(name, ())
    plants = [plant for plant in resampled if plant.is_stable and plant.gain and plant.dead_s >= 0]
    if not plants:
        messages.append(
            "the fit gives no resampled plants that settle: margins are those of the fitted plant only"
        )
    return FittedPlant(
        name, fitted.transfers[name], fitted.data, tuple(plants[:resamples]), fitted.estimates.get(name, {}),
        tuple(messages), fitted.rmse.get(name),
    )  # fmt: skip


def cycle_of(job: FitJob) -> float | None:
    """Return the length of the gait's cycle in a run's trials, s; None if it has none or they differ."""
    if is_recording(job.target):
        return None
    values = sorted({outcome.period_s for outcome in open_run(job.target).outcomes if outcome.period_s})
    return values[0] if values and values[-1] <= values[0] * (1 + 1e-6) else None


def averaged_over(job: FitJob, settings: PidFitSettings) -> float:
    """Return the time over which the feedback is a mean, s. Raises RequestError: it is not known."""
    if settings.feedback == "latest":
        return 0.0
    if settings.period_s is not None:
        return settings.period_s
    cycle_s = cycle_of(job) if settings.feedback == "cycle-average" else None
    if cycle_s is None:
        raise RequestError(
            f'feedback = "{settings.feedback}" is a mean, and it is not known over how long',
            hint="say it: --set period_s=0.714, or --set feedback=latest if nothing is averaged",
        )
    return cycle_s


def summary(plant: FittedPlant, result: Study) -> FitSummary:
    """Return what is printed and stored."""
    settings, loop, transfer = result.settings, result.loop, plant.transfer
    rate_hz = settings.rate_hz
    details: dict[str, Any] = {
        "response": plant.response,
        "plant": {
            "numerator": list(transfer.numerator),
            "denominator": list(transfer.denominator),
            **{key: getattr(transfer, key) for key in ("dead_s", "input_unit", "output_unit")},
        },
        "loop": {
            "rate_hz": rate_hz,
            "compute_s": settings.compute_s,
            "feedback": settings.feedback,
            "average_s": loop.average_s,
            "effective_dead_s": loop.delay_s,
        },
        "recommended": result.best,
        "designs": {design.name: as_json(design, rate_hz) for design in result.designs},
        "spreads": {
            name: {
                "gain_margin_ci95": finite(spread.gain),
                "phase_margin_deg_ci95": finite(spread.phase_deg),
                "unstable_share": spread.unstable_share,
            }
            for name, spread in result.spreads.items()
        },
        "tracking": {
            name: {f"{factor:g}": list(pair) for factor, pair in errors.items()}
            for name, errors in result.errors.items()
        },
    }
    over = f" over {loop.average_s:.4g} s" if loop.average_s else ""
    heading = (
        f"Controllers for {plant.response}, designed on {transfer}, fitted to {plant.data.name}.\n"
        f"For a loop at {rate_hz:g} Hz with feedback {settings.feedback}{over}; "
        f"gains in {words.drive_per_output(result)}."
    )
    feedback = f"mean over {loop.average_s:.3g} s" if loop.average_s else "latest sample"
    title = f"Controllers for {plant.response} of {plant.data.name}\nat {rate_hz:g} Hz, feedback: {feedback}"
    title += f"; * recommended: {result.best}" if result.best else ""
    loop_name = _LOOP_NAMES.get(plant.response, plant.response)
    return FitSummary(
        method="pid",
        model_name=f"controllers for {plant.response}",
        data=plant.data,
        parameters=plant.parameters,
        rmse={} if plant.rmse is None else {plant.response: plant.rmse},
        rmse_units={plant.response: transfer.output_unit},
        tables=words.tables(result),
        findings=tuple(words.findings(result)),
        warnings=(*plant.warnings, *words.warnings(result)),
        details=details,
        files={"pid.toml": controllers_toml(result.designs, result.best, settings.i_per, loop_name, heading)},
        figure_data=lambda: words.design_figure(result, title),
    )
