"""Stiffness and damping of a hinge from free swings, both ways: chapter 3's, and by simulation; what else they tell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from labrun.devices import FloatArray
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
    TextTable,
    correlation_length,
    fit_model,
    load_dataset,
    resample_trials,
    rounded,
    silent,
    student,
)
from labrun.models import Model
from labrun_plugins.rigs.hinge.body import FOUND, Body, hinge_model, taken_as_stated
from labrun_plugins.rigs.hinge.releases import (
    FourierSwing,
    Release,
    fit_fourier,
    fit_release,
    fourier_system,
    fourier_values,
    mean_over_releases,
)

_CLOSE = 5e-3
_ABOVE_NOISE = 2.0
"""A residual this many times the sensor's noise is not noise: the model lacks something."""
_FEWEST_FOR_A_TREND = 5
_AMPLITUDES_APART = 1.3
_SURE = 0.995
"""Quantile of Student's t that a trend has to exceed: one in a hundred data sets without one shows one."""
_LEAST_TREND = 0.02
_NORMAL = 1.96


@dataclass(frozen=True, slots=True)
class Trend:
    """A straight line of one quantity over the release's amplitude.

    Attributes
    ----------
    at_rest : Estimate
        Where the line meets amplitude zero.
    small, large
        The quantity at the smallest and at the largest amplitude.
    growth, growth_half_width
        From there to there, relative to the value at the smallest, with half of its 95 % interval.
    sure
        Whether there is a trend at all.
    residual : (T,)
        What is left of every release's value.
    """

    at_rest: Estimate
    small: float
    large: float
    growth: float
    growth_half_width: float
    sure: bool
    residual: FloatArray


def trend(amplitude: FloatArray, values: FloatArray, unit: str) -> Trend | None:
    """Return the line of least squares; None for too few releases, or where all are alike in amplitude."""
    count = len(values)
    low, high = float(np.min(amplitude)), float(np.max(amplitude))
    if count < _FEWEST_FOR_A_TREND or high < _AMPLITUDES_APART * low:
        return None
    matrix = np.column_stack([np.ones(count), amplitude])
    line = np.linalg.lstsq(matrix, values, rcond=None)[0]
    residual = values - matrix @ line
    covariance = np.linalg.inv(matrix.T @ matrix) * float(residual @ residual) / (count - 2)
    at_rest, per_rad = float(line[0]), float(line[1])
    half_at_rest, half_slope = student(count - 2) * np.sqrt(np.diag(covariance))
    small, large = at_rest + per_rad * low, at_rest + per_rad * high
    size = max(abs(small), 1e-300)
    growth = per_rad * (high - low) / size
    error = float(np.sqrt(covariance[1, 1]))
    sure = abs(per_rad) > student(count - 2, _SURE) * error and abs(growth) > _LEAST_TREND
    return Trend(
        Estimate(at_rest, (at_rest - float(half_at_rest), at_rest + float(half_at_rest)), unit),
        small,
        large,
        growth,
        float(half_slope) * (high - low) / size,
        bool(sure),
        residual,
    )


def by_test(
    trials: Sequence[FitTrial], releases: Sequence[Release], units: Sequence[str]
) -> tuple[TextTable, ...]:
    """Return stiffness and damping of every test with mean and scatter, as Table 3.2; none without two tests.

    A test is what the conditions call ``test``; its values are means over its releases.
    """
    tests: dict[float | str, list[FloatArray]] = {}
    for trial, release in zip(trials, releases, strict=True):
        if "test" in trial.condition:
            tests.setdefault(trial.condition["test"], []).append(release.values)
    if len(tests) < 2:
        return ()
    values = np.array([np.mean(tests[name], axis=0) for name in sorted(tests, key=str)])
    mean, sd = values.mean(axis=0), values.std(axis=0, ddof=1)
    rows = [
        (f"{name:g}" if isinstance(name, float | int) else name, *(f"{value:.4g}" for value in row))
        for name, row in zip(sorted(tests, key=str), values, strict=True)
    ]
    rows += [
        ("mean", *(f"{value:.4g}" for value in mean)),
        ("standard deviation", *(f"{value:.2g}" for value in sd)),
        ("of the mean", *(f"{100 * share:.2g} %" for share in sd / np.abs(mean))),
    ]
    header = ("test", *(f"{name}, {unit}" for name, unit in zip(FOUND, units, strict=True)))
    return (TextTable(f"between {len(tests)} tests", header, tuple(rows)),)


def release_findings(releases: Sequence[Release], units: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return findings, and warnings, on how stiffness and damping differ from release to release."""
    values = np.array([release.values for release in releases])
    sigma = np.array([release.sigma for release in releases])
    amplitude = np.array([release.amplitude_rad for release in releases])
    small_deg, large_deg = np.degrees([np.min(amplitude), np.max(amplitude)])
    spreads, warnings = [], []
    for column, (name, unit) in enumerate(zip(FOUND, units, strict=True)):
        line = trend(amplitude, values[:, column], unit)
        about = values[:, column] - values[:, column].mean()
        freedom = len(values) - 1
        if line is not None and line.sure:
            warnings.append(_told(name, line, float(small_deg), float(large_deg)))
            about, freedom = line.residual, freedom - 1
        # what the residual of each release leaves open is no scatter of the hinge
        variance = float(about @ about) / freedom - float(np.mean(sigma[:, column] ** 2))
        size = abs(float(values[:, column].mean()))
        if variance > 0 and size > 0:
            spreads.append(f"{name} varies by {100 * np.sqrt(variance) / size:.2g} %")
    findings = [f"between releases {' and '.join(spreads)} (standard deviation)"] if spreads else []
    return findings, warnings


def _told(name: str, line: Trend, small_deg: float, large_deg: float) -> str:
    way = "grows" if line.growth * line.small > 0 else "falls"
    cause = {
        ("damping", "grows"): "air drag does that, which eq. (3.5) lacks",
        ("damping", "falls"): "dry friction does that, which eq. (3.5) lacks",
    }.get((name, way), "the spring is not linear, or the angle's zero is not where the hinge is flat")
    value, low, high = rounded(line.at_rest)
    sure = f"95 % interval \N{PLUS-MINUS SIGN}{100 * line.growth_half_width:.1g} %"
    return (
        f"{name} {way} from {line.small:.3g} to {line.large:.3g} {line.at_rest.unit} between releases from "
        f"{small_deg:.0f} and from {large_deg:.0f} deg "
        f"({100 * line.growth:+.0f} %, {sure}): {cause}; "
        f"extrapolated to small swings it is {value} ({low} ... {high}) {line.at_rest.unit}"
    )


def body_shares(body: Body, stiffness: float) -> dict[str, float]:
    """Return by what share of itself each quantity may be shifted by the stated body (95 %), all releases alike.

    The frequency gives ``(k + m g r) / I``, the decay ``b / I``, for small swings. Empty where the body is known, or
    its gravity torque is fitted, too.
    """
    if body.gravity_torque is None or (body.inertia_tolerance == 0 and body.gravity_tolerance == 0):
        return {}
    by_inertia = body.inertia_tolerance * abs(stiffness + body.gravity_torque)
    by_gravity = body.gravity_tolerance * abs(body.gravity_torque)
    return {
        "stiffness": _NORMAL * float(np.hypot(by_inertia, by_gravity)) / max(abs(stiffness), 1e-300),
        "damping": _NORMAL * body.inertia_tolerance,
    }


def body_warning(body: Body, shares: dict[str, float], *, in_intervals: bool) -> list[str]:
    """Say what the uncertainty of the stated body means: it shifts all releases, and both ways, alike."""
    if not shares:
        return []
    shifts = ", ".join(f"{name} by up to {100 * share:.2g} %" for name, share in shares.items())
    return [
        f"the body is taken as stated: inertia to {100 * body.inertia_tolerance:.2g} %, gravity_torque to "
        f"{100 * body.gravity_tolerance:.2g} %. That shifts both ways alike and is "
        f"{'in' if in_intervals else 'not in'} the intervals: {shifts} (95 %)"
    ]


def with_body(estimates: dict[str, Estimate], shares: dict[str, float]) -> dict[str, Estimate]:
    """Return estimates whose intervals cover both how releases scatter and what the stated body may shift."""
    widened = {}
    for name, estimate in estimates.items():
        shift = shares.get(name.removesuffix("_fourier"), 0.0) * abs(estimate.value)
        low, high = (float(np.hypot(end - estimate.value, shift)) for end in estimate.ci95)
        widened[name] = (
            Estimate(estimate.value, (estimate.value - low, estimate.value + high), estimate.unit)
            if shift
            else estimate
        )
    return widened


def agreement_warnings(estimates: dict[str, Estimate], fourier: dict[str, Estimate]) -> list[str]:
    """Return what both ways do not agree on."""
    return [
        f"the two ways disagree on {name}: {_text(estimates[name])} by simulation, {_text(estimate)} by Fourier "
        "derivatives; on a swing that follows eq. (3.5) they agree"
        for name, estimate in fourier.items()
        if name in estimates and _apart(estimates[name], estimate)
    ]


def residual_warning(rmse: float, noise: float) -> list[str]:
    """Say that eq. (3.5) leaves more than the sensor's noise, which is what a Fourier series leaves."""
    if rmse <= _ABOVE_NOISE * noise:
        return []
    return [
        f"eq. (3.5) leaves {1e3 * rmse:.2g} mrad where a Fourier series of each swing leaves "
        f"{1e3 * noise:.2g} mrad: the swing has forces that it lacks, such as dry friction or air drag, "
        "and they bias its parameters"
    ]


def _apart(estimate: Estimate, other: Estimate) -> bool:
    """Tell whether two intervals do not meet, and the values differ by more than numbers do."""
    close = abs(estimate.value - other.value) <= _CLOSE * max(abs(estimate.value), abs(other.value))
    return not close and (estimate.ci95[1] < other.ci95[0] or other.ci95[1] < estimate.ci95[0])


def _text(estimate: Estimate) -> str:
    value, low, high = rounded(estimate)
    return f"{value} ({low} ... {high})"


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
    body_in_intervals: bool = True,
) -> FitResult:
    """Fit eq. (3.5) to free swings both ways.

    ``(I_G + m r^2) theta'' = -k theta - b theta' - m g r sin(theta)``; the printed gravity term lacks r.

    `stiffness` and `damping` come from simulating every swing from free initial states (output error),
    `stiffness_fourier` and `damping_fourier` from chapter 3's way: a Fourier series of every swing, differentiated
    analytically (`fit_fourier`), then linear least squares.

    A hinge differs from release to release (Table 3.2: by 2.3 % in k, 3.2 % in b), and a common k would run out of
    phase within seconds. Every release is therefore fitted by itself; the estimates are means over releases, with
    intervals from resampling whole releases, and how much releases differ is among the findings. The body is
    taken as stated; what its tolerance means for the result is in the intervals, and told.

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
    body_in_intervals
        Whether intervals cover the tolerance of the stated body, beside the scatter of releases.

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
    shares = body_shares(body, result.parameters["stiffness"].value)
    warnings = (*warnings, *body_warning(body, shares, in_intervals=body_in_intervals))
    parameters = dict(result.parameters)
    if body_in_intervals:
        parameters = with_body(parameters, shares)
    return replace(result, parameters=parameters, warnings=warnings)


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
    means = mean_over_releases(np.array([release.values for release in releases]), units, rng)
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
    warnings += [*trends, *agreement_warnings(means, fourier), *residual_warning(rmse, noise)]
    return FitResult(
        method="hinge",
        model_name=model.name,
        data=FittedData.of(dataset),
        dataset=dataset,
        parameters={**means, **_renamed(fourier)},
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
    named_values = {
        f"{name}{way}": float(values[index]) for way, values in ways for index, name in enumerate(FOUND)
    }
    return {**named_values, "amplitude_rad": release.amplitude_rad}


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
            float(values[index]),
            (float(values[index] + spread.low[index]), float(values[index] + spread.high[index])),
            units[name],
        )
        for index, name in enumerate(names)
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
