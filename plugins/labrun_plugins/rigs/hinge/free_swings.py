"""Stiffness and damping of a hinge from free swings, both ways: chapter 3's, and by simulation."""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from labrun.errors import FitError
from labrun.fit import (
    FEW_TRIALS,
    Dataset,
    Estimate,
    FitJob,
    FitResult,
    FittedData,
    FitTrial,
    NoSettings,
    Note,
    correlation_length,
    fit_model,
    load_dataset,
    resample_trials,
    silent,
)
from labrun.models import Model
from labrun_plugins.rigs.hinge.body import FOUND, Body, hinge_model, taken_as_stated
from labrun_plugins.rigs.hinge.findings import (
    agreement_warnings,
    body_warning,
    by_test,
    release_findings,
    residual_warning,
)
from labrun_plugins.rigs.hinge.fourier import FourierSwing, fit_fourier
from labrun_plugins.rigs.hinge.releases import (
    Release,
    fit_release,
    fourier_system,
    fourier_values,
    mean_over_releases,
)

STARTS = 2
"""A hinge fit starts from its own Fourier estimate."""
_BLOCKS = 10


class HingeFit:
    """Stiffness and damping by Fourier derivatives and by simulation; the model says what is known of the body."""

    Settings: ClassVar[type[BaseModel]] = NoSettings

    def __init__(self, settings: NoSettings) -> None:  # noqa: ARG002  (has none)
        return

    def __call__(self, job: FitJob) -> FitResult:
        """Fit; see `fit_hinge`."""
        hinge = hinge_model(job.model)
        names = {output.name for output in hinge.outputs}
        signals = {name: channel for name, channel in job.signals.items() if name in names}
        dataset = load_dataset(job.target, hinge, signals)
        return fit_hinge(dataset, job.model, rng=job.rng, starts=job.starts or STARTS, note=job.note)


def fit_hinge(
    dataset: Dataset,
    known: Model | None,
    *,
    rng: np.random.Generator,
    starts: int = STARTS,
    note: Note = silent,
) -> FitResult:
    """Fit eq. (3.5) to free swings both ways.

    ``(I_G + m r^2) theta'' = -k theta - b theta' - m g r sin(theta)``; the printed gravity term lacks r.

    `stiffness` and `damping` come from simulating every swing from free initial states (output error),
    `stiffness_fourier` and `damping_fourier` from chapter 3's way: a Fourier series of every swing, differentiated
    analytically (`fit_fourier`), then linear least squares.

    A hinge differs from release to release (Table 3.2: by 2.3 % in k, 3.2 % in b), and a common k would run out of
    phase within seconds. Every release is therefore fitted by itself; the estimates are means over releases, with
    intervals from resampling whole releases, and how much releases differ is among the findings. The body is
    taken as stated; what its tolerance means for the result is a warning.

    Where the gravity torque is not known, or there is one release only, one k and b (and gravity torque) are fitted
    to all swings together; only swings of large angles tell gravity (sine) from a linear spring.

    Parameters
    ----------
    dataset
        One output, the angle in rad, zero where the body hangs and the hinge is flat.
    known
        See `hinge_model`.
    starts
        Of the simulation of all swings together; few are enough, because the Fourier estimate is the first of them.

    Raises
    ------
    FitError
        Mass properties are missing; swings too short; an angle in another unit; swings that eq. (3.5) does not follow.
    """
    if len(dataset.outputs) != 1 or dataset.outputs[0].unit != "rad":
        named = ", ".join(f"{output.name} ({output.unit})" for output in dataset.outputs)
        raise FitError(f"a hinge fit takes one angle in rad; {dataset.name} gives {named}")
    model = hinge_model(known)
    body = Body.of(model)
    model = taken_as_stated(model)
    note("Fourier series of every swing")
    swings = [fit_fourier(trial.time_s, trial.outputs[:, 0], trial.label) for trial in dataset.trials]
    if body.gravity_torque is None or len(dataset.trials) == 1:
        result = _together(dataset, model, body, swings, rng, starts, note)
    else:
        result = _one_by_one(dataset, model, body, swings, rng, note)
    warnings = result.warnings
    if len(dataset.trials) < FEW_TRIALS and len(dataset.trials) > 1:
        warnings = (*warnings, f"the Fourier intervals, too, rest on {len(dataset.trials)} trials only")
    warnings = (*warnings, *body_warning(body, result.parameters["stiffness"].value))
    return replace(result, warnings=warnings)


def _one_by_one(
    dataset: Dataset,
    model: Model,
    body: Body,
    swings: Sequence[FourierSwing],
    rng: np.random.Generator,
    note: Note,
) -> FitResult:
    kept: list[tuple[FitTrial, FourierSwing, Release]] = []
    refused: list[FitError] = []
    for number, (trial, swing) in enumerate(zip(dataset.trials, swings, strict=True), start=1):
        note(f"release {number} of {len(swings)}")
        try:
            kept.append((trial, swing, fit_release(model, dataset, trial, swing, body)))
        except FitError as error:
            refused.append(error)
    if len(kept) < max(2, len(refused)):
        raise refused[0]
    trials, swings, releases = zip(*kept, strict=True)
    left_out = dataset.left_out + len(refused)
    dataset = replace(dataset, trials=trials, left_out=left_out)
    units = [parameter.unit for name in FOUND for parameter in model.parameters if parameter.name == name]
    found = mean_over_releases(np.array([release.values for release in releases]), units, rng)
    fourier = mean_over_releases(np.array([release.fourier for release in releases]), units, rng)
    simulated = tuple(release.simulated for release in releases)
    squares = [
        (trial.outputs - outputs) ** 2 for trial, outputs in zip(dataset.trials, simulated, strict=True)
    ]
    rmse = float(np.sqrt(np.mean(np.concatenate(squares))))
    findings, trends = release_findings(releases, units)
    warnings = [f"left out: {error.args[0]}" for error in refused]
    if len(trials) < FEW_TRIALS:
        warnings.append(
            f"intervals rest on {len(trials)} trials only and are coarse; {FEW_TRIALS} or more would support them"
        )
    noise = float(np.sqrt(np.mean([swing.noise**2 for swing in swings])))
    warnings += [*trends, *agreement_warnings(found, fourier), *residual_warning(rmse, noise)]
    return FitResult(
        method="hinge",
        model_name=model.name,
        data=FittedData.of(dataset),
        dataset=dataset,
        parameters={**found, **_renamed(fourier)},
        fixed={parameter.name: parameter.value for parameter in model.parameters if parameter.tolerance == 0},
        rmse={dataset.outputs[0].name: rmse},
        rmse_units={dataset.outputs[0].name: dataset.outputs[0].unit},
        simulated=simulated,
        initial_states=tuple(release.initial_state for release in releases),
        warnings=tuple(warnings),
        findings=tuple(findings),
        tables=by_test(trials, releases, units),
        by_trial=tuple(_named(release) for release in releases),
    )


def _named(release: Release) -> dict[str, float]:
    ways = (("", release.values), ("_fourier", release.fourier))
    found = {f"{name}{way}": float(values[place]) for way, values in ways for place, name in enumerate(FOUND)}
    return {**found, "amplitude_rad": release.amplitude_rad}


def _renamed(fourier: dict[str, Estimate]) -> dict[str, Estimate]:
    return {f"{name}_fourier": estimate for name, estimate in fourier.items()}


def _together(
    dataset: Dataset,
    model: Model,
    body: Body,
    swings: Sequence[FourierSwing],
    rng: np.random.Generator,
    starts: int,
    note: Note,
) -> FitResult:
    fourier = _fourier_together(swings, body, model, rng)
    # chapter 3's estimate is an excellent start for the simulation
    start = {name: estimate.value for name, estimate in fourier.items() if estimate.value != 0.0}
    result = fit_model(model.with_values(start), dataset, rng=rng, starts=starts, note=note, method="hinge")
    noise = float(np.sqrt(np.mean([swing.noise**2 for swing in swings])))
    warnings = [
        *result.warnings,
        *agreement_warnings(dict(result.parameters), fourier),
        *residual_warning(result.rmse[dataset.outputs[0].name], noise),
        *_without_spring(result, model, dataset, rng),
    ]
    parameters = {**result.parameters, **_renamed(fourier)}
    return replace(result, parameters=parameters, warnings=tuple(warnings))


def _fourier_together(
    swings: Sequence[FourierSwing], body: Body, model: Model, rng: np.random.Generator
) -> dict[str, Estimate]:
    """Return chapter 3's estimate from all swings at once; intervals by resampling swings, or pieces of one."""
    names = [*FOUND, *["gravity_torque"] * (body.gravity_torque is None)]
    systems = [fourier_system(swing, body) for swing in swings]
    if len(systems) == 1:
        matrix, right = systems[0]
        systems = list(zip(np.array_split(matrix, _BLOCKS), np.array_split(right, _BLOCKS), strict=True))
    values = fourier_values(swings, body)
    residuals = [right - matrix @ values for matrix, right in systems]
    noise = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2) * correlation_length(residuals)))
    noise = max(noise, 1e-12 * body.inertia)
    information = np.array([matrix.T @ matrix for matrix, _ in systems]) / noise**2
    score = np.array([matrix.T @ left for (matrix, _), left in zip(systems, residuals, strict=True)])
    spread = resample_trials(information, score / noise**2, rng=rng)
    units = {parameter.name: parameter.unit for parameter in model.parameters}
    return {
        name: Estimate(
            float(values[place]),
            (float(values[place] + spread.low[place]), float(values[place] + spread.high[place])),
            units[name],
        )
        for place, name in enumerate(names)
    }


def _without_spring(result: FitResult, model: Model, dataset: Dataset, rng: np.random.Generator) -> list[str]:
    """Say what the spring is worth where it may as well be absent."""
    stiffness = result.parameters["stiffness"]
    if not stiffness.contains_zero:
        return []
    output = dataset.outputs[0].name
    fixed = tuple(
        replace(parameter, value=0.0, tolerance=0.0) if parameter.name == "stiffness" else parameter
        for parameter in model.parameters
    )
    values = {name: estimate.value for name, estimate in result.parameters.items() if name != "stiffness"}
    plain = fit_model(replace(model, parameters=fixed).with_values(values), dataset, rng=rng, starts=1)
    with_spring, without = 1e3 * result.rmse[output], 1e3 * plain.rmse[output]
    return [
        f"without any spring the residual is {without:.3g} mrad, with it {with_spring:.3g} mrad: "
        "nothing here shows a stiffness of the hinge"
    ]
