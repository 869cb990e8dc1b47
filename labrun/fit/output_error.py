"""Output-error fits: simulate every trial, compare with what was measured, change parameters until they agree best."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.estimate import Estimate
from labrun.fit.dataset import Dataset, load_dataset
from labrun.fit.levenberg_marquardt import Minimum, minimise, search
from labrun.fit.method import FitJob, NoSettings, Note, WithSettings, silent
from labrun.fit.problem import OutputNoise, Problem
from labrun.fit.result import FitResult, FittedData, StartOutcome
from labrun.fit.uncertainty import (
    by_mounting,
    correlation_length,
    divergence_warnings,
    interval_warnings,
    resample_trials,
    sign_warnings,
    start_warnings,
    undetermined,
)
from labrun.models import Model

FEW_TRIALS = 5
_STARTS = 5
_BLOCKS = 10
"""Pieces that a single trial is cut into; fewer where its residual stays correlated for longer than that."""
_SMALLEST_SHARE = 1e-3
_PRIOR_WHILE_SEARCHING = 0.1
"""Weight of stated tolerances before the size of the residual is known: as for a residual of a few percent."""


@dataclass(frozen=True, slots=True)
class ResidualSize:
    """Size of the residual of each output.

    Attributes
    ----------
    sigma : (m,)
        Root mean square.
    correlated : (m,)
        Over how many samples it stays correlated (integrated autocorrelation); 1 for white noise.
    """

    sigma: FloatArray
    correlated: FloatArray


class ModelFit(WithSettings[NoSettings]):
    """Output-error fit: the parameters whose simulated outputs are nearest to the measured ones."""

    Settings: ClassVar[type[BaseModel]] = NoSettings

    def __call__(self, job: FitJob) -> FitResult:
        """Fit `job.model`; see `fit_model`."""
        if job.model is None:
            raise RequestError(
                f"no model named for {job.target}",
                hint="name one with --model FILE, or as [fit] model in the experiment, "
                "or put model.toml beside recording.toml",
            )
        dataset = job.check(load_dataset(job.target, job.model, job.signals))
        return fit_model(job.model, dataset, rng=job.rng, starts=job.starts or _STARTS, note=job.note)


def fit_model(
    model: Model,
    dataset: Dataset,
    *,
    rng: np.random.Generator,
    starts: int = 5,
    note: Note = silent,
    method: str = "model",
) -> FitResult:
    """Fit a model's parameters, and free initial states per trial, to measured outputs.

    Minimised is the sum of squared residuals, each output in units of its own residual and of how long that stays
    correlated, plus ``((value - stated) / (tolerance * stated))^2`` for each parameter with a tolerance: stated
    knowledge weighs as one measurement of that standard deviation. Tolerance 0 fixes a parameter, "free" means no
    such term.

    Intervals come from resampling whole trials (see `resample_trials`); those of a single trial from resampling
    contiguous blocks of it, which is said in a warning, as it is when there are fewer than 5 trials.

    Parameters
    ----------
    rng
        Draws the starts and the resamples.
    starts
        Number of starts; 1 fits from the stated values only.
    note
        Called with what is being done.

    Raises
    ------
    FitError
        No parameter to fit; a model that does not simulate from its stated values nor from any other start.
    """
    first = Problem.of(model, dataset, prior_weight=_PRIOR_WHILE_SEARCHING)
    if not first.size and not first.own_size:
        raise FitError(
            f"model {model.name} has nothing to fit: every parameter has tolerance 0",
            hint='give a parameter tolerance = "free", or a relative standard deviation such as 0.05',
        )
    minima = search(first, rng, starts=starts, note=note)
    best = minima[0]
    if first.simulate(first.parameters(best.z), 0, first.own(best.z, 0)) is None:
        raise FitError(
            f"model {model.name} does not simulate {dataset.name}: its states leave the finite numbers",
            hint="check the units of its parameters and inputs, and the sign of forces that should resist motion",
        )
    note("refining, and resampling trials")
    problem, z, noise = _refine(Problem.of(model, dataset, substeps=first.substeps), best.z)
    return _result(problem, z, noise, minima, rng, method)


def _refine(problem: Problem, z: FloatArray) -> tuple[Problem, FloatArray, ResidualSize]:
    """Weigh each output by its own residual, and the prior against that, until both settle."""
    refined = problem.refined(z)
    if refined.substeps > problem.substeps:
        z = minimise(refined, z)
    problem = refined
    noise = residual_noise(problem, z)
    for _ in range(3):
        problem = problem.with_noise(OutputNoise(1.0 / (noise.sigma * np.sqrt(noise.correlated))))
        z = minimise(problem, z)
        before, noise = noise, residual_noise(problem, z)
        if np.allclose(noise.sigma, before.sigma, rtol=1e-2) and np.allclose(
            noise.correlated, before.correlated, rtol=0.1
        ):
            break
    return problem, z, noise


def residual_noise(problem: Problem, z: FloatArray) -> ResidualSize:
    """Return size and correlation of the residual of each output at `z`."""
    outputs = len(problem.spread)
    residuals = [part.reshape(-1, outputs) / problem.noise.weights for part in problem.residuals(z)]
    sigma, correlated = np.empty(outputs), np.empty(outputs)
    for column in range(outputs):
        parts = [part[:, column] for part in residuals]
        # a model that fits to the last digit must not get infinite weight
        sigma[column] = max(_rms(np.concatenate(parts)), 1e-9 * float(problem.spread[column]))
        correlated[column] = correlation_length(parts)
    return ResidualSize(sigma, correlated)


def _result(
    problem: Problem,
    z: FloatArray,
    noise: ResidualSize,
    minima: Sequence[Minimum],
    rng: np.random.Generator,
    method: str,
) -> FitResult:
    dataset, model, priors = problem.data, problem.model, problem.priors
    parameters = problem.parameters(z)
    owns = [problem.own(z, index) for index in range(len(dataset.trials))]
    simulated = []
    for index, own in enumerate(owns):
        outputs = problem.simulate(parameters, index, own)
        if outputs is None:
            raise FitError(
                f"model {model.name} leaves the finite numbers in {dataset.trials[index].label}, even where it fits "
                "best",
                hint="look at that trial: labrun fit compares every trial with one set of parameters",
            )
        simulated.append(outputs)
    pairs = zip(dataset.trials, simulated, strict=True)
    left = np.concatenate([trial.outputs - outputs for trial, outputs in pairs])
    warnings: list[str] = []
    estimates: dict[str, Estimate] = {}
    named: frozenset[str] = frozenset()
    if problem.size:
        information, score, warning = _sums(problem, z, noise)
        warnings += warning
        sigma = priors.sigma / priors.scale
        resampled = resample_trials(information, score, rng=rng, prior_sigma=sigma)
        centre = z[: problem.size]
        # directions are told in shares of the estimates; one next to zero has no share
        share = np.maximum(np.abs(centre), _SMALLEST_SHARE)
        relative = (information.sum(axis=0) + np.diag(1.0 / np.square(sigma))) * share[:, None] * share
        messages, named, least = undetermined(relative, priors.names)
        ends = np.minimum(resampled.low, -least * share), np.maximum(resampled.high, least * share)
        low, high = (np.clip(centre + end, priors.lower, priors.upper) * priors.scale for end in ends)
        for index, (name, variable) in enumerate(zip(priors.names, priors.free, strict=True)):
            interval = (float(low[index]), float(high[index]))
            estimates[name] = Estimate(float(parameters[variable]), interval, model.parameters[variable].unit)
        warnings += messages
        warnings += interval_warnings(estimates, problem, named)
        warnings += sign_warnings(estimates, problem)
    outcomes = []
    for minimum in minima:
        values = problem.parameters(minimum.z)[priors.free].tolist()
        start_values = dict(zip(priors.names, values, strict=True))
        outcomes.append(StartOutcome(minimum.label, start_values, minimum.misfit))
    warnings += divergence_warnings(problem, z)
    warnings += start_warnings(outcomes, estimates, direction_named=bool(named))
    names = [output.name for output in dataset.outputs]
    return FitResult(
        method=method,
        model_name=model.name,
        data=FittedData.of(dataset),
        dataset=dataset,
        parameters=estimates,
        fixed={parameter.name: parameter.value for parameter in model.parameters if parameter.tolerance == 0},
        rmse={name: _rms(left[:, column]) for column, name in enumerate(names)},
        rmse_units={output.name: output.unit for output in dataset.outputs},
        simulated=tuple(simulated),
        initial_states=tuple(problem.initial_state(index, own) for index, own in enumerate(owns)),
        warnings=tuple(warnings),
        starts=tuple(outcomes),
    )


def _sums(problem: Problem, z: FloatArray, noise: ResidualSize) -> tuple[FloatArray, FloatArray, list[str]]:
    """Return J'J and J'r of every unit that is resampled, and what has to be said about the units."""
    jacobian = problem.jacobian(z)
    parts = list(zip(jacobian.shared, jacobian.own, jacobian.residual, strict=True))
    warnings, trials = [], len(parts)
    if trials > 1:
        pairs = [eliminated(*part) for part in parts]
        if trials < FEW_TRIALS:
            warnings.append(
                f"intervals rest on {trials} trials only and are coarse; {FEW_TRIALS} or more would support them"
            )
    else:
        length = len(problem.data.trials[0].time_s)
        count = int(np.clip(length / (2.0 * float(np.max(noise.correlated))), 3, _BLOCKS))
        pairs = _cut(*parts[0], count)
        warnings.append(
            f"there is one trial only: intervals come from {count} pieces of it and know nothing of how trials differ"
        )
    # J is the derivative of measured minus simulated, so the pull on a parameter has the other sign
    information = np.array([matrix for matrix, _ in pairs])
    score = np.array([-pull for _, pull in pairs])
    if trials > 1:
        mountings = [trial.mounting for trial in problem.data.trials]
        information, score, remark = by_mounting(information, score, mountings)
        warnings += [remark] if remark else []
    return information, score, warnings


def eliminated(shared: FloatArray, own: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return J'J and J'r of the shared parameters, what the trial's own initial states can imitate projected out."""
    if own.shape[1]:
        basis = np.linalg.svd(own, full_matrices=False)
        span = basis[0][:, basis[1] > 1e-10 * max(float(basis[1][0]), 1e-300)]
        shared = shared - span @ (span.T @ shared)
        residual = residual - span @ (span.T @ residual)
    return shared.T @ shared, shared.T @ residual


def _cut(
    shared: FloatArray, own: FloatArray, residual: FloatArray, count: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Cut one trial into contiguous pieces; its initial states, common to all of them, are projected out first."""
    if own.shape[1]:
        span = np.linalg.qr(own)[0]
        shared = shared - span @ (span.T @ shared)
        residual = residual - span @ (span.T @ residual)
    pieces = zip(np.array_split(shared, count), np.array_split(residual, count), strict=True)
    return [(piece.T @ piece, piece.T @ part) for piece, part in pieces]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
