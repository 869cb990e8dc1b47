"""What pictures and the search for places need: courses of the most telling units, and the difference itself."""

from typing import TYPE_CHECKING

import numpy as np

from labrun.gap import criteria
from labrun.gap.diagnosis import Trace
from labrun.gap.excess import mean_residuals

if TYPE_CHECKING:
    from labrun.gap.engine import Search
    from labrun.gap.where.difference import Difference


def traces_of(search: "Search", *, with_causes: bool) -> tuple[Trace, ...]:
    """Return measured and simulated courses of the worst unit of each of the worst conditions, the worst first."""
    recalibration = search.recalibration
    problem, final = recalibration.problem, search.selection.final
    raw = problem.simulated(recalibration.raw)
    recalibrated = problem.simulated(recalibration.z)
    after = final.problem.simulated(final.z) if with_causes else recalibrated
    sizes = [
        float(np.mean(np.square((trial.outputs - one) / search.noise.sd)))
        for trial, one in zip(problem.dataset.trials, recalibrated, strict=True)
    ]
    worst: dict[int, int] = {}
    for index in sorted(range(len(sizes)), key=lambda index: -sizes[index]):
        worst.setdefault(problem.units.units[index].group, index)
    order = list(worst.values())[: criteria.CONDITIONS_SHOWN]
    return tuple(
        Trace(
            unit.trial.label,
            unit.trial.condition,
            unit.count,
            unit.trial.time_s,
            unit.trial.inputs,
            unit.trial.outputs,
            raw[index],
            recalibrated[index],
            after[index],
        )
        for index in order
        for unit in [problem.units.units[index]]
    )


def difference_of(search: "Search") -> "Difference":
    """Return what the recalibrated model and the measurement differ by."""
    from labrun.gap.where.difference import Difference

    problem, z = search.recalibration.problem, search.recalibration.z
    units = range(len(problem.units.units))
    return Difference(
        problem.model,
        problem.units,
        search.noise,
        problem.model_parameters(z),
        problem.attached(problem.parameters(z)),
        tuple(problem.initial_state(index, problem.own(z, index)) for index in units),
        tuple(problem.drive(index) for index in units),
        tuple(problem.simulated(z)),
        tuple(mean_residuals(problem, z)),
        problem.sensitivities(z),
    )
