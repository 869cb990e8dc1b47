"""The recalibrated model: what its parameters, within their tolerances, can explain by themselves."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.fit.descent import minimise
from labrun.fit.notes import Note
from labrun.fit.search import search
from labrun.gap import criteria
from labrun.gap.noise import Noise, from_repeats, from_residual
from labrun.gap.problem import GapProblem, own_states
from labrun.gap.screening import refit

if TYPE_CHECKING:
    from labrun.gap.units import Units
    from labrun.models import Model

FloatArray = NDArray[np.float64]


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

    problem: GapProblem
    noise: Noise
    raw: FloatArray
    z: FloatArray


def recalibrate(model: "Model", units: "Units", rng: np.random.Generator, note: Note) -> Recalibrated:
    """Fit the parameters within their tolerances, find the noise, and fit again in its units."""
    problem = GapProblem(model, units)
    note("recalibrating the model within what is known of its parameters")
    z = search(problem, rng, starts=criteria.RECALIBRATION_STARTS, note=lambda _: None)[0].z
    if problem.refine_steps(z):
        z = refit(problem, z)
    deviations = member_residuals(problem, z)
    noise = from_repeats(units, deviations) or from_residual(units, deviations).plain()
    return in_noise(problem, noise, z)


def in_noise(problem: GapProblem, noise: Noise, z: FloatArray) -> Recalibrated:
    """Fit once more in units of a noise."""
    measured = problem.with_noise(noise)
    z = refit(measured, z)
    if measured.shorten_steps(z):
        z = refit(measured, z)
    return Recalibrated(measured, noise, stated(measured, z), z)


def stated(problem: GapProblem, z: FloatArray) -> FloatArray:
    """Return the stated parameters with each unit's own initial states fitted."""
    shared = problem.values[problem.free] / problem.scale
    start = np.concatenate([shared, own_states(problem, z)])
    return minimise(problem, start, lower=shared, upper=shared) if problem.own_size else start


def member_residuals(problem: GapProblem, z: FloatArray) -> list[list[FloatArray]]:
    """Return measured minus simulated of every trial, unit by unit."""
    return [
        [one - outputs for one in unit.members]
        for unit, outputs in zip(problem.units.units, problem.simulated(z), strict=True)
    ]


def unsearched(problem: GapProblem, z: FloatArray) -> tuple[str, ...]:
    """Return sentences on what is believed of the parameters and does not simulate.

    Each parameter in turn is taken to both ends of what is believed of it, the others where they are; and what left the
    finite numbers on the way of the fits was counted.
    """
    said, found = problem.tally.remarks, list[str]()
    for variable, name in enumerate(problem.names[: problem.size]):
        if not np.isfinite(problem.prior_sigma[variable]):
            continue
        for end in (problem.lower[variable], problem.upper[variable]):
            if np.isfinite(end) and not _simulates(problem, z, variable, float(end)):
                found.append(f"{name} = {end * problem.scale[variable]:.4g}")
    if not found:
        return said
    return (
        f"The model leaves the finite numbers with {' and with '.join(found)}, which what is stated allows: a part of "
        "its range does not simulate, and was not searched.",
        *said,
    )


def _simulates(problem: GapProblem, z: FloatArray, variable: int, value: float) -> bool:
    changed = z.copy()
    changed[variable] = value
    parameters, units = (
        problem.parameters(changed),
        range(min(criteria.PROBED_UNITS, len(problem.dataset.trials))),
    )
    return all(problem.simulate(parameters, unit, problem.own(changed, unit)) is not None for unit in units)


def bound_remarks(problem: GapProblem, z: FloatArray) -> tuple[str, ...]:
    """Return a sentence for every parameter that recalibration took to the end of what is believed of it."""
    found = []
    for variable, name in enumerate(problem.names[: problem.size]):
        at_end = z[variable] <= problem.lower[variable] or z[variable] >= problem.upper[variable]
        if at_end and np.isfinite(problem.prior_sigma[variable]):
            found.append(
                f"recalibration took {name} to {criteria.WITHIN_TOLERANCES:g} times its tolerance, "
                "as far as its statement is believed"
            )
    return tuple(found)
