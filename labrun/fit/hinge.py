"""Stiffness and damping of a hinge from free swings, both ways: chapter 3's, and by simulation."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.errors import FitError
from labrun.fit.dataset import Dataset
from labrun.fit.fourier import FourierSwing, fit_fourier
from labrun.fit.notes import Note, silent
from labrun.fit.output_error import FEW_TRIALS, correlation_length, fit_model
from labrun.fit.resampling import resample_trials
from labrun.fit.result import Estimate, FitResult, rounded

if TYPE_CHECKING:
    from labrun.models import Model, Parameter

FloatArray = NDArray[np.float64]

_BLOCKS = 10
_CLOSE = 5e-3
_ABOVE_NOISE = 2.0
"""A residual this many times the sensor's noise is not noise: the model lacks something."""


@dataclass(frozen=True, slots=True)
class FourierEstimate:
    """Chapter 3's estimate.

    Attributes
    ----------
    estimates
        By name, as in the model: stiffness, damping, and gravity_torque where that is not known.
    noise
        Root mean square over the swings of what the Fourier series left, rad.
    """

    estimates: dict[str, Estimate]
    noise: float


def hinge_model(known: "Model | None") -> "Model":
    """Return eq. (3.5) with what another model knows of the body.

    Parameters
    ----------
    known
        A model with the parameters `inertia` (I_G + m r^2, kg m^2) and `gravity_torque` (m g r, N m), such as
        that of the experiment or of a recording; values and tolerances are taken over, those of `stiffness` and
        `damping` too where it has them.

    Raises
    ------
    FitError
        No model, or one that knows neither.
    """
    from labrun.models import load_model

    model = load_model(Path(__file__).with_name("hinge.toml"))
    stated = {} if known is None else {parameter.name: parameter for parameter in known.parameters}
    missing = [name for name in ("inertia", "gravity_torque") if name not in stated]
    if missing:
        source = "no model says" if known is None else f"model {known.name} does not have"
        raise FitError(
            f"a hinge fit needs the body's {' and '.join(missing)}, which {source}",
            hint="a swing alone gives ratios only: name a model with the parameters inertia (kg m^2) and "
            "gravity_torque (N m) by --model",
        )
    parameters = tuple(_taken_over(parameter, stated) for parameter in model.parameters)
    angle = known.outputs[0].name if known is not None and known.outputs else "angle"
    if angle == "angle":
        return replace(model, parameters=parameters)
    outputs = tuple(replace(output, name=angle) for output in model.outputs)
    return replace(model, parameters=parameters, outputs=outputs)


def _taken_over(parameter: "Parameter", stated: "dict[str, Parameter]") -> "Parameter":
    if parameter.name not in stated:
        return parameter
    other = stated[parameter.name]
    free = parameter.name in ("stiffness", "damping")
    return replace(parameter, value=other.value, tolerance="free" if free else other.tolerance)


def fit_hinge(
    dataset: Dataset,
    known: "Model | None",
    *,
    rng: np.random.Generator,
    starts: int = 2,
    note: Note = silent,
) -> FitResult:
    """Fit eq. (3.5) to free swings both ways.

    ``(I_G + m r^2) theta'' = -k theta - b theta' - m g r sin(theta)``; the printed gravity term lacks r.

    `stiffness` and `damping` come from simulating every swing from free initial states (output error, `fit_model`),
    `stiffness_fourier` and `damping_fourier` from chapter 3's way: a Fourier series of every swing, differentiated
    analytically (`fit_fourier`), then linear least squares over all swings. Both intervals come from resampling whole
    trials. Where the gravity torque is not known, it is estimated too; only swings of large angles tell it (sine)
    from a linear spring.

    Parameters
    ----------
    dataset
        One output, the angle in rad, zero where the body hangs and the hinge is flat.
    known
        See `hinge_model`.
    starts
        Of the simulation; few are enough, because the Fourier estimate is the first of them.

    Raises
    ------
    FitError
        Mass properties are missing; swings too short; an angle in another unit.
    """
    if len(dataset.outputs) != 1 or dataset.outputs[0].unit != "rad":
        named = ", ".join(f"{output.name} ({output.unit})" for output in dataset.outputs)
        raise FitError(f"a hinge fit takes one angle in rad; {dataset.name} gives {named}")
    model = hinge_model(known)
    note("Fourier series of every swing")
    fourier = fit_fourier_hinge(dataset, model, rng)
    # chapter 3's estimate is an excellent start for the simulation
    start = {name: estimate.value for name, estimate in fourier.estimates.items() if estimate.value != 0.0}
    stated = {parameter.name: parameter for parameter in model.parameters}
    start = {name: value for name, value in start.items() if stated[name].tolerance == "free"}
    result = fit_model(model.with_values(start), dataset, rng=rng, starts=starts, note=note, method="hinge")
    parameters = dict(result.parameters)
    for name, estimate in fourier.estimates.items():
        parameters[f"{name}_fourier"] = estimate
    warnings = [*result.warnings, *_findings(result, fourier, model, dataset, rng)]
    return replace(result, parameters=parameters, warnings=tuple(warnings))


def fit_fourier_hinge(dataset: Dataset, model: "Model", rng: np.random.Generator) -> FourierEstimate:
    """Return chapter 3's estimate: linear least squares in the derivatives of a Fourier series of every swing.

    Unknown are stiffness and damping, and the gravity torque where the model does not know it exactly; then its stated
    value and tolerance count as one measurement. The inertia is taken as stated, and a tolerance of it widens the
    intervals.
    """
    swings = [fit_fourier(trial.time_s, trial.outputs[:, 0], trial.label) for trial in dataset.trials]
    stated = {parameter.name: parameter for parameter in model.parameters}
    inertia, gravity = stated["inertia"], stated["gravity_torque"]
    names = ["stiffness", "damping"] + ["gravity_torque"] * (gravity.tolerance != 0)
    prior_value, prior_sigma = np.zeros(len(names)), np.full(len(names), np.inf)
    if gravity.tolerance not in (0, "free"):
        prior_value[2], prior_sigma[2] = gravity.value, float(gravity.tolerance) * abs(gravity.value)
    systems = [_system(swing, inertia.value, gravity.value, len(names)) for swing in swings]
    units = systems if len(systems) > 1 else _pieces(*systems[0])
    values, residuals = _solve(units, prior_value, prior_sigma, noise=1.0)
    # a residual that stays correlated counts for fewer measurements against the prior
    noise = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2) * correlation_length(residuals)))
    noise = max(noise, 1e-12 * abs(inertia.value))
    values, residuals = _solve(units, prior_value, prior_sigma, noise)
    information = np.array([matrix.T @ matrix for matrix, _ in units]) / noise**2
    score = np.array([matrix.T @ left for (matrix, _), left in zip(units, residuals, strict=True)]) / noise**2
    resampled = resample_trials(information, score, rng=rng, prior_sigma=prior_sigma)
    draws = resampled.draws
    if not isinstance(inertia.tolerance, str) and inertia.tolerance > 0:
        step = inertia.tolerance
        heavier = [_system(swing, inertia.value * (1 + step), gravity.value, len(names)) for swing in swings]
        moved, _ = _solve(heavier, prior_value, prior_sigma, noise)
        draws = draws + np.outer(rng.standard_normal(len(draws)), moved - values)
    spread = np.percentile(draws, [2.5, 97.5], axis=0)
    estimates = {}
    for index, name in enumerate(names):
        low, high = min(spread[0, index], 0.0), max(spread[1, index], 0.0)
        value = float(values[index])
        estimates[name] = Estimate(value, (value + float(low), value + float(high)), stated[name].unit)
    return FourierEstimate(estimates, float(np.sqrt(np.mean([swing.noise**2 for swing in swings]))))


def _system(
    swing: FourierSwing, inertia: float, gravity: float, unknowns: int
) -> tuple[FloatArray, FloatArray]:
    """Return matrix and right side of eq. (3.5), one row a sample."""
    columns = [swing.angle, swing.rate]
    right = -inertia * swing.acceleration
    if unknowns == 3:
        columns.append(np.sin(swing.angle))
    else:
        right = right - gravity * np.sin(swing.angle)
    return np.column_stack(columns), right


def _pieces(matrix: FloatArray, right: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    return list(zip(np.array_split(matrix, _BLOCKS), np.array_split(right, _BLOCKS), strict=True))


def _solve(
    systems: list[tuple[FloatArray, FloatArray]],
    prior_value: FloatArray,
    prior_sigma: FloatArray,
    noise: float,
) -> tuple[FloatArray, list[FloatArray]]:
    weights = np.where(np.isfinite(prior_sigma), noise / prior_sigma, 0.0)
    matrix = np.vstack([*(matrix for matrix, _ in systems), np.diag(weights)])
    right = np.concatenate([*(right for _, right in systems), weights * prior_value])
    values = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return values, [right - matrix @ values for matrix, right in systems]


def _findings(
    result: FitResult, fourier: FourierEstimate, model: "Model", dataset: Dataset, rng: np.random.Generator
) -> list[str]:
    """Return what comparing both ways, the noise and the model without a spring says."""
    findings = []
    if len(dataset.trials) < FEW_TRIALS:
        findings.append(f"the Fourier intervals, too, rest on {len(dataset.trials)} trials only")
    for name in fourier.estimates:
        simulated, differentiated = result.parameters.get(name), fourier.estimates[name]
        if simulated is not None and _apart(simulated, differentiated):
            findings.append(
                f"the two ways disagree on {name}: {_text(simulated)} by simulation, "
                f"{_text(differentiated)} by Fourier derivatives; "
                "on a swing that follows eq. (3.5) they agree"
            )
    rmse = result.rmse[dataset.outputs[0].name]
    if rmse > _ABOVE_NOISE * fourier.noise:
        findings.append(
            f"eq. (3.5) leaves {1e3 * rmse:.2g} mrad where a Fourier series of each swing leaves "
            f"{1e3 * fourier.noise:.2g} mrad: "
            "the swing has forces that it lacks, such as dry friction or air drag, and they bias its parameters"
        )
    findings += _without_spring(result, model, dataset, rng)
    return findings


def _without_spring(
    result: FitResult, model: "Model", dataset: Dataset, rng: np.random.Generator
) -> list[str]:
    """Say what the spring is worth where it may as well be absent."""
    stiffness = result.parameters["stiffness"]
    if not stiffness.contains_zero:
        return []
    output = dataset.outputs[0].name
    fixed = tuple(
        replace(parameter, value=0.0, tolerance=0.0) if parameter.name == "stiffness" else parameter
        for parameter in model.parameters
    )
    values = {
        name: estimate.value
        for name, estimate in result.parameters.items()
        if name in ("damping", "gravity_torque")
    }
    plain = fit_model(replace(model, parameters=fixed).with_values(values), dataset, rng=rng, starts=1)
    with_spring, without = 1e3 * result.rmse[output], 1e3 * plain.rmse[output]
    return [
        f"without any spring the residual is {without:.3g} mrad, with it {with_spring:.3g} mrad: "
        "nothing here shows a stiffness of the hinge"
    ]


def _apart(one: Estimate, other: Estimate) -> bool:
    """Tell whether two intervals do not meet, and the values differ by more than numbers do."""
    close = abs(one.value - other.value) <= _CLOSE * max(abs(one.value), abs(other.value))
    return not close and (one.ci95[1] < other.ci95[0] or other.ci95[1] < one.ci95[0])


def _text(estimate: Estimate) -> str:
    value, low, high = rounded(estimate)
    return f"{value} ({low} ... {high})"
