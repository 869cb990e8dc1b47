"""From a run to a summary of designs."""

from typing import TYPE_CHECKING, Any

from labrun.errors import RequestError
from labrun.fit.summary import FitSummary
from labrun.fit.transfer import TransferFunction
from labrun.fit.tuning import words
from labrun.fit.tuning.design import as_json
from labrun.fit.tuning.plant import Plant, cycle_of, find_plant
from labrun.fit.tuning.settings import PidSettings
from labrun.fit.tuning.snippet import controllers_toml
from labrun.fit.tuning.study import Study, study
from labrun.fit.tuning.tables import tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from labrun.fit.method import FitJob

_LOOP_NAMES = {"magnitude": "force"}
"""What the loop around a response is called in the experiments that labrun brings along."""


def design_controllers(job: "FitJob", settings: PidSettings) -> FitSummary:
    """Fit the plant, design controllers for it, and judge them.

    Raises
    ------
    RequestError
        No such response; an average over a cycle without one.
    FitError
        The plant cannot be fitted, or is one that does not settle.
    """
    plant = find_plant(job, settings)
    average_s = averaged_over(job, settings)
    job.note(f"designing controllers for {plant.response}")
    return summary(plant, study(plant.transfer, plant.plants, settings, average_s))


def averaged_over(job: "FitJob", settings: PidSettings) -> float:
    """Return the time over which the feedback is a mean, s.

    Raises
    ------
    RequestError
        It is not known.
    """
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


def summary(plant: Plant, found: Study) -> FitSummary:
    """Return what is printed and stored."""
    settings = found.settings
    rate_hz = settings.rate_hz
    details = {
        "response": plant.response,
        "plant": _plant_json(plant.transfer),
        "loop": {
            "rate_hz": rate_hz,
            "compute_s": settings.compute_s,
            "feedback": settings.feedback,
            "average_s": found.loop.average_s,
            "effective_dead_s": found.loop.delay_s,
        },
        "recommended": found.best,
        "designs": {one.name: as_json(one, rate_hz) for one in found.designs},
        "spreads": {
            name: {
                "gain_margin_ci95": _finite(spread.gain),
                "phase_margin_deg_ci95": _finite(spread.phase_deg),
                "unstable_share": spread.unstable_share,
            }
            for name, spread in found.spreads.items()
        },
        "tracking": {
            name: {f"{factor:g}": list(pair) for factor, pair in errors.items()}
            for name, errors in found.errors.items()
        },
    }
    loop_name = _LOOP_NAMES.get(plant.response, plant.response)
    heading = (
        f"Controllers for {plant.response}, designed on {plant.transfer}, fitted to {plant.data.name}.\n"
        f"For a loop at {rate_hz:g} Hz with feedback {settings.feedback}"
        + (f" over {found.loop.average_s:.4g} s" if found.loop.average_s else "")
        + f"; gains in {words.drive_per_output(found)}."
    )
    file = controllers_toml(found.designs, found.best, settings.i_per, loop_name, heading)
    return FitSummary(
        method="pid",
        model_name=f"controllers for {plant.response}",
        data=plant.data,
        parameters=plant.parameters,
        rmse={} if plant.rmse is None else {plant.response: plant.rmse},
        rmse_units={plant.response: plant.transfer.output_unit},
        tables=tables(found),
        findings=tuple(words.findings(found)),
        warnings=(*plant.warnings, *words.warnings(found)),
        details=details,
        files={"pid.toml": file},
        picture=lambda: _picture(plant, found),
    )


def _picture(plant: Plant, found: Study) -> "Figure":
    from labrun.fit.tuning.figure import draw_designs

    loop = found.loop
    feedback = f"mean over {loop.average_s:.3g} s" if loop.average_s else "latest sample"
    title = (
        f"Controllers for {plant.response} of {plant.data.name}, at {loop.rate_hz:g} Hz, feedback: {feedback}"
        + (f"; * recommended: {found.best}" if found.best else "")
    )
    return draw_designs(found, title)


def _plant_json(transfer: TransferFunction) -> dict[str, Any]:
    return {
        "numerator": list(transfer.numerator),
        "denominator": list(transfer.denominator),
        "dead_s": transfer.dead_s,
        "input_unit": transfer.input_unit,
        "output_unit": transfer.output_unit,
    }


def _finite(pair: tuple[float, float]) -> list[float | None]:
    return [value if abs(value) < float("inf") else None for value in pair]
