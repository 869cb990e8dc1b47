"""From what the search ended with to a diagnosis."""

from collections.abc import Callable

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Note, OutputNoise, Problem
from labrun.gap import ladder
from labrun.gap.cause_table import candidate_table, causes_of
from labrun.gap.diagnosis import ComparedTrace, Diagnosis, MissingForce, Place
from labrun.gap.held_out import mean_residuals
from labrun.gap.noise import from_residual
from labrun.gap.pipeline import Search
from labrun.gap.recalibration import member_residuals
from labrun.gap.trial_wise import remaining, words
from labrun.gap.where.difference import Difference

_CONDITIONS_SHOWN = 4
"""Conditions of which courses are kept for pictures, those with the largest gap first."""


def traces_of(search: Search, *, with_causes: bool) -> tuple[ComparedTrace, ...]:
    """Return measured and simulated courses of the worst unit of each of the worst conditions, the worst first."""
    recalibration = search.recalibration
    problem, final = recalibration.problem, search.selection.final
    raw = problem.simulated(recalibration.raw)
    recalibrated = problem.simulated(recalibration.z)
    after = final.problem.simulated(final.z) if with_causes else recalibrated
    sizes = [
        float(np.mean(np.square((trial.outputs - simulated) / search.noise.sd)))
        for trial, simulated in zip(problem.data.trials, recalibrated, strict=True)
    ]
    worst: dict[int, int] = {}
    for index in sorted(range(len(sizes)), key=lambda index: -sizes[index]):
        worst.setdefault(problem.data.trials[index].group, index)
    order = list(worst.values())[:_CONDITIONS_SHOWN]
    return tuple(
        ComparedTrace(
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
    noise = search.noise
    if not noise.known:  # noise to tell places by: what the causes leave, with its colour
        final = search.selection.final
        noise = from_residual(problem.data, member_residuals(final.problem, final.z))
    return Difference(
        problem.model,
        problem.data,
        noise,
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


def conclude(
    search: Search,
    rng: np.random.Generator,
    *,
    seed: int,
    elapsed_s: Callable[[], float],
    places: bool,
    note: Note,
) -> Diagnosis:
    """Put the result of a search into a diagnosis.

    Parameters
    ----------
    seed
        What `rng` was made from.
    elapsed_s
        Returns how long the whole has taken so far.
    """
    dataset, selection = search.dataset, search.selection
    problem, z, final = search.recalibration.problem, search.recalibration.z, selection.final
    causes = causes_of(search, dataset, rng)
    sizes = ladder.sizes_of(search)
    if not search.is_quiet:
        note("measuring what of the rest is predictable")
    rest = ladder.rest_of(search, selection.steps[-1], ask=not search.is_quiet)
    decided = ladder.verdict_of(search, causes, rest)
    located: tuple[Place, ...] = ()
    missing: tuple[MissingForce, ...] = ()
    if places and decided != "no-gap":
        from labrun.gap.where.forces import missing_forces
        from labrun.gap.where.places import find_places

        note("looking where the gap is")
        difference = difference_of(search)
        located = find_places(difference, rng, note=note)
        if decided in ("partly-explained", "unexplained"):
            missing = missing_forces(difference)
    channels = tuple((output.name, output.unit) for output in dataset.outputs)
    input_channels = tuple((signal.name, signal.unit) for signal in dataset.inputs)
    differs = tuple(
        words(deviation, channels, problem.model.states, input_channels, mean)
        for deviation, mean in remaining(final.problem, final.z)
    )
    recalibrated, last = _named(problem, z), _named(final.problem, final.z)
    repeats = search.data.repeats
    return Diagnosis(
        name=dataset.name,
        model=problem.model.name,
        source=str(dataset.source),
        verdict=decided,
        differs=differs,
        sentence=ladder.sentence_of(
            decided, sizes, causes, rest, differs, search.noise, complete=not selection.stopped
        ),
        gap=sizes,
        where=located,
        causes=causes,
        candidates=candidate_table(search, dataset, causes),
        shrinkage=ladder.shrinkage_of(search, rng),
        recalibration={
            parameter.name: (parameter.value, parameter.tolerance, recalibrated[parameter.name])
            for parameter in problem.model.parameters
        },
        corrected=last if causes else recalibrated,
        effects=final.problem.attached(final.problem.parameters(final.z)) if causes else (),
        limitations=(*ladder.limitations_of(search), *search.limitations),
        notes=(*search.data.notes, *search.notes, *problem.model.notes, *search.remarks),
        what_next=tuple(ladder.next_steps(decided, causes, rest, repeats, selection.stopped)),
        channels=channels,
        input_channels=input_channels,
        noise={output.name: float(sd) for output, sd in zip(dataset.outputs, search.noise.sd, strict=True)},
        trials=sum(trial.count for trial in search.data.trials),
        conditions=len(search.data.conditions),
        repeats=repeats,
        missing=missing,
        traces=traces_of(search, with_causes=bool(causes)),
        parameter_units={parameter.name: parameter.unit for parameter in problem.model.parameters},
        seed=seed,
        seconds=elapsed_s(),
        ladder=ladder.ladder_of(search, [name for name, _ in channels]),
        rest=rest,
        stopped=selection.stopped,
    )


def _named(problem: Problem, z: FloatArray) -> dict[str, float]:
    """Return the model's parameters by name."""
    values = problem.model_parameters(z)
    pairs = zip(problem.model.parameters, values, strict=True)
    return {parameter.name: float(value) for parameter, value in pairs}
