"""What pictures and the search for places need: courses of the most telling units, and the difference itself."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.problem import OutputNoise, Problem
from labrun.gap import criteria
from labrun.gap.diagnosis import Trace
from labrun.gap.engine import Search
from labrun.gap.excess import mean_residuals
from labrun.gap.where.difference import Difference


def traces_of(search: Search, *, with_causes: bool) -> tuple[Trace, ...]:
    """Return measured and simulated courses of the worst unit of each of the worst conditions, the worst first."""
    recalibration = search.recalibration
    problem, final = recalibration.problem, search.selection.final
    raw = problem.simulated(recalibration.raw)
    recalibrated = problem.simulated(recalibration.z)
    after = final.problem.simulated(final.z) if with_causes else recalibrated
    sizes = [
        float(np.mean(np.square((trial.outputs - one) / search.noise.sd)))
        for trial, one in zip(problem.data.trials, recalibrated, strict=True)
    ]
    worst: dict[int, int] = {}
    for index in sorted(range(len(sizes)), key=lambda index: -sizes[index]):
        worst.setdefault(problem.data.trials[index].group, index)
    order = list(worst.values())[: criteria.CONDITIONS_SHOWN]
    return tuple(
        Trace(
            unit.label,
            unit.condition,
            unit.count,
            unit.time_s,
            unit.inputs,
            unit.outputs,
            raw[index],
            recalibrated[index],
            after[index],
        )
        for index in order
        for unit in [problem.data.trials[index]]
    )


def difference_of(search: Search) -> Difference:
    """Return what the recalibrated model and the measurement differ by."""
    from labrun.gap.where.difference import Difference

    problem, z = search.recalibration.problem, search.recalibration.z
    units = range(len(problem.data.trials))
    return Difference(
        problem.model,
        problem.data,
        search.noise,
        problem.model_parameters(z),
        problem.attached(problem.parameters(z)),
        tuple(problem.initial_state(index, problem.own(z, index)) for index in units),
        tuple(problem.drives[index] for index in units),
        tuple(problem.simulated(z)),
        tuple(mean_residuals(problem, z)),
        _sensitivities(problem, z),
    )


def _sensitivities(problem: Problem, z: FloatArray) -> FloatArray:
    """Return the derivative of the simulated outputs by all variables but effect sizes, (sum of n*m, variables).

    Trial after trial, each (n, m) row by row, in the units of the outputs.
    """
    coloured = problem.with_noise(OutputNoise(problem.noise.weights))
    jacobian = coloured.jacobian(z)
    rows = []
    for index, (shared, own) in enumerate(zip(jacobian.shared, jacobian.own, strict=True)):
        trial = problem.data.trials[index]
        wide = np.zeros((trial.outputs.size, len(z)))
        wide[:, : problem.size] = shared[: trial.outputs.size]
        begin = problem.size + index * problem.own_size
        wide[:, begin : begin + problem.own_size] = own[: trial.outputs.size]
        rows.append(-wide / np.tile(problem.noise.weights, len(trial.time_s))[:, None])
    return np.concatenate(rows)
