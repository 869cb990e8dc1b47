"""The recalibrated model: what its parameters, within their tolerances, can explain by themselves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError
from labrun.estimate import significant
from labrun.fit import (
    Dataset,
    Deviation,
    Each,
    Note,
    OutputNoise,
    Problem,
    minimise,
    one_by_one,
    search,
)
from labrun.gap import criteria, numerics
from labrun.gap.averaging import averaged
from labrun.gap.held_out import ExcessResidual, fitted_excess, floor_of, mean_residuals
from labrun.gap.noise import (
    Noise,
    fit_whitener,
    from_reading_errors,
    from_repeats,
    independent_share,
    of_sensor,
)
from labrun.gap.screening import refit
from labrun.gap.trial_wise import deviating_initial_states, deviations_of_repeats
from labrun.models import Model

_PROBED_UNITS = 3
"""Trials that are simulated with a parameter at the end of what is believed of it, to see whether it simulates."""
_SAME_COURSE = 0.95
"""Correlation with the stated model from which an output is its multiple."""
_NEAR_FACTOR = 0.15
"""Part by which that multiple may differ from a common mistake."""
_REWEIGHED = 8
"""Most fits without repeats in units of what the one before left."""
_UNITS_SETTLED = 0.02
"""Part by which these units may still change once they have settled."""
_INTEGRATION_ERROR = 1.0
"""Squares, in units of the noise and over all samples, that halving the integrator's steps may move the outputs by."""
_MOST_SUBSTEPS = 64
"""Steps of the integrator per sample beyond which they are not halved again."""

_REPLACED = 0.1
"""Part of its size up to which a term of the model counts as replaced by a cause."""

Held = TypeVar("Held", bound=Problem)


@dataclass(frozen=True)
class Recalibrated:
    """A model fitted within what is known of it.

    Attributes
    ----------
    raw
        Stated parameters; only the units' own initial states are fitted.
    z
        Recalibrated.
    """

    problem: Problem
    noise: Noise
    raw: FloatArray
    z: FloatArray


def recalibrate(
    model: Model, units: Dataset, rng: np.random.Generator, note: Note, each: Each = one_by_one
) -> Recalibrated:
    """Fit the parameters within their tolerances, find the noise, and fit again in its units.

    Parameters
    ----------
    each
        How trials are simulated, here and by all that is made of the problem.
    """
    problem = replace(stated_problem(model, units), each=each)
    note("recalibrating the model within what is known of its parameters")
    z = search(problem, rng, starts=numerics.RECALIBRATION_STARTS, note=lambda _: None)[0].z
    refined = problem.refined(z)
    if refined.substeps > problem.substeps:
        z = refit(refined, z)
    problem = refined
    drawn = deviations_of_repeats(units, member_residuals(problem, z), problem.simulated(z))
    noise = (
        from_repeats(units, drawn.residual)
        or from_reading_errors(units)
        or of_sensor(units, mean_residuals(problem, z))
    )
    deviations = drawn.deviations if noise.known else deviating_initial_states(problem, z, noise.sd)
    if deviations:
        note("asking what differs from trial to trial")
    if noise.known and deviations:
        problem, z = with_deviations(problem, z, deviations)
    for deviation in () if noise.known else deviations:
        problem, z = _with_deviating_initial_state(problem, z, noise, deviation)
    return in_noise(problem, noise, z)


def _with_deviating_initial_state(
    problem: Problem, z: FloatArray, noise: Noise, beginning: Deviation
) -> tuple[Problem, FloatArray]:
    """Return a problem whose trials begin elsewhere, fitted; as it was if noise of the colour of the rest does as much.

    The mean of a trial's first samples wanders with slow noise as that of any others does (likelihood ratio of the
    innovations, a number for each trial).
    """
    from scipy.stats import chi2

    without = settled_in_own_units(noise, problem, z)
    fitted = settled_in_own_units(noise, *with_deviations(problem, z, (beginning,)))
    sd = np.sqrt(np.mean(np.square(np.concatenate(mean_residuals(*fitted))), axis=0))
    sd = np.where(sd > 0, sd, 1.0)
    before, after = (
        [residual / sd for residual in mean_residuals(*solution)] for solution in (without, fitted)
    )
    whitener = fit_whitener(after)
    gain = sum(
        float(np.sum(np.square(whitener.white(first))) - np.sum(np.square(whitener.white(other))))
        for first, other in zip(before, after, strict=True)
    )
    return fitted if chi2.sf(gain, len(after)) <= criteria.DEVIATION_P else (problem, z)


def with_deviations(
    problem: Problem, z: FloatArray, deviations: Sequence[Deviation]
) -> tuple[Problem, FloatArray]:
    """Return a problem whose trials have further deviations of their own, and where it begins."""
    own = problem.own_states(z).reshape(len(problem.data.trials), problem.own_size)
    own = np.column_stack([own, np.zeros((len(own), len(deviations)))])
    problem = replace(problem, deviations=(*problem.deviations, *deviations))
    return problem, np.concatenate([z[: problem.size], own.ravel()])


def in_noise(problem: Problem, noise: Noise, z: FloatArray) -> Recalibrated:
    """Fit once more in units of a noise."""
    measured, z = fitted_in_own_units(noise, problem, z)
    finer = with_shorter_steps(measured, z)
    if finer is not measured:
        z = refit(finer, z)
    finer = _for_stated(finer, z)
    return Recalibrated(finer, noise, stated(finer, z), z)


def _for_stated(problem: Problem, z: FloatArray) -> Problem:
    """Return the problem in steps so short that the stated parameters simulate, too; itself if none are."""
    at, finer = np.concatenate([problem.priors.stated, problem.own_states(z)]), problem
    while finer.finite_residuals(at) is None:
        if finer.substeps >= _MOST_SUBSTEPS:
            return problem
        finer = finer.with_substeps(2 * finer.substeps)
    return finer


def fitted_in_own_units(noise: Noise, problem: Problem, z: FloatArray) -> tuple[Problem, FloatArray]:
    """Fit in units of the noise; where nothing was repeated, of what the fit leaves, until these have settled."""
    if not noise.known:
        problem, z = settled_in_own_units(noise, problem, z)
    problem = in_units_of(noise, problem, z)
    return problem, refit(problem, z)


def settled_in_own_units(noise: Noise, problem: Problem, z: FloatArray) -> tuple[Problem, FloatArray]:
    """Fit in units of what the fit leaves, until these have settled: closely enough to tell how much that is.

    Zeros by trial are as large as a hundred times the noise: what is left shrinks with each fit, until they are gone.
    """
    problem = in_units_of(noise, problem, z)
    for _ in range(_REWEIGHED):
        z = minimise(
            problem,
            z,
            tolerance=numerics.FIT_TOLERANCE,
            evaluations=numerics.FIT_EVALUATIONS,
            central=False,
            secant=True,
            confirmed=False,
        )
        before, problem = problem, in_units_of(noise, problem, z)
        if np.allclose(problem.noise.weights, before.noise.weights, rtol=_UNITS_SETTLED):
            break
    return problem, z


def stated_problem(model: Model, data: Dataset) -> Problem:
    """Hold a model against averaged trials, its parameters within their tolerances, in units of the outputs' spread.

    A state that begins at the "first" samples is free, held by what noise they have.
    """
    return as_stated(Problem.of(model, data))


def as_stated(problem: Held) -> Held:
    """Return a problem of any kind as `stated_problem` holds one."""
    return replace(problem, priors=problem.priors.within(criteria.WITHIN_TOLERANCES), read_free=True)


def in_units_of(noise: Noise, problem: Problem, z: FloatArray) -> Problem:
    """Return the problem in units of a noise.

    Where nothing was repeated, in units of what the model leaves at `z`, as if its independent numbers were all there
    are: what is stated of the parameters then weighs as much as it does beside so many measurements.
    """
    sd = noise.sd
    if not noise.known:
        residual = mean_residuals(problem, z)
        sd = np.maximum(np.sqrt(np.mean(np.square(np.concatenate(residual)), axis=0)), noise.sd)
        sd = sd / np.sqrt(independent_share(residual))
    sd = np.sqrt(sd**2 + (criteria.MODEL_ROUNDING * problem.spread) ** 2)
    return problem.with_noise(OutputNoise(1.0 / sd, noise.white_mean))


def with_shorter_steps(problem: Problem, z: FloatArray) -> Problem:
    """Halve the integrator's steps until that moves the outputs by a small part of the noise.

    What integration alone differs by must not be taken for physics.
    """
    before = problem.simulated(z)
    while problem.substeps < _MOST_SUBSTEPS:
        finer = problem.with_substeps(2 * problem.substeps)
        after = finer.simulated(z)
        moved = sum(
            float(np.sum(np.square((outputs - two) * problem.noise.weights)))
            for outputs, two in zip(before, after, strict=True)
        )
        if moved <= _INTEGRATION_ERROR:
            break
        problem, before = finer, after
    return problem


def stated(problem: Problem, z: FloatArray) -> FloatArray:
    """Return the stated parameters with each unit's own initial states fitted."""
    shared = problem.priors.stated
    start = np.concatenate([shared, problem.own_states(z)])
    return minimise(problem, start, lower=shared, upper=shared) if problem.own_size else start


def member_residuals(problem: Problem, z: FloatArray) -> list[list[FloatArray]]:
    """Return measured minus simulated of every trial, unit by unit."""
    return [
        [member - outputs for member in trial.members]
        for trial, outputs in zip(problem.data.trials, problem.simulated(z), strict=True)
    ]


def unit_remarks(problem: Problem, stated: FloatArray) -> tuple[str, ...]:
    """Return a sentence for every output that is the model's own, with stated parameters, but for its sign or unit.

    No physics makes an output -1 or 57.3 times what a model says and leaves its course as it is.
    """
    simulated = problem.simulated(stated)
    warnings = []
    for column, output in enumerate(problem.data.outputs):
        ours = np.concatenate([outputs[:, column] for outputs in simulated])
        theirs = np.concatenate([trial.outputs[:, column] for trial in problem.data.trials])
        ours, theirs = ours - ours.mean(), theirs - theirs.mean()
        size, energy = float(ours @ theirs), float(ours @ ours)
        if energy == 0.0 or size**2 < _SAME_COURSE**2 * energy * float(theirs @ theirs):
            continue
        for factor, words in _MISTAKEN.items():
            if abs(size / energy / factor - 1.0) < _NEAR_FACTOR:
                warnings.append(
                    f"{output.name} is {significant(size / energy, 3)} times what the model says and runs as it does: "
                    f"{words}. Check this before anything else."
                )
    return tuple(warnings)


_MISTAKEN = {
    -1.0: "its sign is flipped",
    180.0 / np.pi: "degrees labelled rad?",
    np.pi / 180.0: "radians labelled degrees?",
    1000.0: "thousandths of its unit (mm labelled m)?",
    0.001: "thousands of its unit (m labelled mm)?",
}
"""Factors of common mistakes."""


def unsearched(problem: Problem, z: FloatArray) -> tuple[str, ...]:
    """Return sentences on what is believed of the parameters and does not simulate.

    Each parameter in turn is taken to both ends of what is believed of it, the others where they are; and what left the
    finite numbers on the way of the fits was counted.
    """
    remarks, messages = problem.simulations.remarks, list[str]()
    for variable, name in enumerate(problem.priors.names[: problem.size]):
        if not np.isfinite(problem.priors.sigma[variable]):
            continue
        for end in (problem.priors.lower[variable], problem.priors.upper[variable]):
            if np.isfinite(end) and not _simulates(problem, z, variable, float(end)):
                messages.append(f"{name} = {end * problem.priors.scale[variable]:.4g}")
    if not messages:
        return remarks
    return (
        f"The model leaves the finite numbers with {' and with '.join(messages)}, which what is stated allows: a part "
        "of its range does not simulate, and was not searched.",
        *remarks,
    )


def _simulates(problem: Problem, z: FloatArray, variable: int, value: float) -> bool:
    changed = z.copy()
    changed[variable] = value
    parameters, units = (
        problem.parameters(changed),
        range(min(_PROBED_UNITS, len(problem.data.trials))),
    )
    return all(problem.simulate(parameters, unit, problem.own(changed, unit)) is not None for unit in units)


def bound_remarks(problem: Problem, z: FloatArray) -> tuple[str, ...]:
    """Return a sentence for every parameter that recalibration took to the end of what is believed of it."""
    warnings = []
    for variable, name in enumerate(problem.priors.names[: problem.size]):
        at_end = (
            z[variable] <= problem.priors.lower[variable] or z[variable] >= problem.priors.upper[variable]
        )
        if at_end and np.isfinite(problem.priors.sigma[variable]):
            warnings.append(
                f"recalibration took {name} to {criteria.WITHIN_TOLERANCES:g} times its tolerance, "
                "as far as its statement is believed"
            )
    return tuple(warnings)


def replaced_terms(problem: Problem, z: FloatArray, corrected: FloatArray) -> tuple[str, ...]:
    """Return a sentence for every free parameter of the model that the causes leave nearly nothing of.

    Parameters
    ----------
    z, corrected
        Variables without and with the causes; the model's own parameters come first in both.
    """
    sentences, priors = [], problem.priors
    for variable, index in enumerate(priors.free):
        if index >= len(problem.model.parameters) or np.isfinite(priors.sigma[variable]):
            continue
        before, after = (float(values[variable]) * float(priors.scale[variable]) for values in (z, corrected))
        if abs(after) < _REPLACED * abs(before):
            sentences.append(
                f"with the causes, {priors.names[variable]} falls from {significant(before)} to {significant(after)}: "
                "that term of the model has the wrong law"
            )
    return tuple(sentences)


def fresh_excess(
    models: Sequence[Model], dataset: Dataset, rng: np.random.Generator
) -> tuple[list[ExcessResidual], float]:
    """Return what models leave of fresh trials, only initial states fitted, and the gap that noise alone shows at most.

    Noise is what repeats do not agree on beside the first model.

    Raises
    ------
    FitError
        No repeats.
    """
    data = averaged(dataset, models[0])
    problem = stated_problem(models[0], data)
    noise = from_repeats(data, member_residuals(problem, stated(problem, problem.begin())))
    if noise is None:
        raise FitError("fresh trials without repeats cannot tell gap from noise")
    problems = [
        in_units_of(noise, problem, problem.begin())
        for problem in (stated_problem(model, data) for model in models)
    ]
    excesses = [fitted_excess(problem, stated(problem, problem.begin()), noise) for problem in problems]
    return excesses, floor_of(data, noise, rng)
