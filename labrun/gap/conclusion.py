"""From what the search found to a diagnosis."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Each, Note, OutputNoise, Problem, one_by_one
from labrun.gap import criteria
from labrun.gap.causes import candidate_table, causes_of
from labrun.gap.confidence import shrinkage
from labrun.gap.diagnosis import (
    ComparedTrace,
    Diagnosis,
    MissingForce,
    Place,
    Shrinkage,
    Sizes,
)
from labrun.gap.held_out import fitted_excess, floor_of, mean_residuals
from labrun.gap.intervals import scatter
from labrun.gap.learnable import beyond_scatter, learnable_share
from labrun.gap.noise import from_residual
from labrun.gap.pipeline import Search
from labrun.gap.recalibration import member_residuals
from labrun.gap.trial_wise import remaining, words
from labrun.gap.verdict import VerdictBasis, limitations, sentence, verdict, what_next
from labrun.gap.what_is_left import BeyondScatter, Learnable
from labrun.gap.where.difference import Difference


def traces_of(search: Search, *, with_causes: bool) -> tuple[ComparedTrace, ...]:
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
    each: Each = one_by_one,
) -> Diagnosis:
    """Put what was found into a diagnosis.

    Parameters
    ----------
    seed
        What `rng` was made from.
    elapsed_s
        Tells how long the whole has taken so far.
    """
    dataset = search.dataset
    problem, noise, z = search.recalibration.problem, search.noise, search.recalibration.z
    selection, final = search.selection, search.selection.final
    floor = floor_of(search.data, noise, rng)
    if selection.chosen:
        # where recalibration predicts worse than what is stated, nobody would recalibrate
        before = min(search.held_out.gap, search.raw.gap)
        sizes = Sizes(search.raw.gap, before, selection.held_out.gap, floor)
    else:  # nothing to compare on withheld conditions, where extrapolated parameters alone would leave a gap
        sizes = Sizes(search.raw.gap, search.recalibrated.gap, search.recalibrated.gap, floor)
    shrunk: Shrinkage | None = None
    if selection.chosen:
        shrunk = shrinkage(search.data, noise, search.held_out, selection.held_out, rng)
    kinds = [one.name.kind for one in selection.chosen]
    settled = noise.known and shrunk is not None and shrunk.low > 0.0
    findings = VerdictBasis(
        sizes,
        search.recalibrated.gap > floor,
        fitted_excess(final.problem, final.z, noise).gap > floor,
        noise.known,
        kinds.count("effect"),
        kinds.count("parameter"),
        shrunk,
        BeyondScatter() if settled else beyond_scatter(final.problem, final.z, noise),
        len(dataset.trials),
    )
    decided = verdict(findings)
    if (
        shrunk is not None and not noise.known
    ):  # what cannot be learned of the rest may be noise, and no gap that is left
        shrunk = replace(shrunk, high=max(shrunk.high, findings.known_share + criteria.FORM_ERROR))
    moved = scatter(final, search.null.draws(final))
    announced = decided not in ("no-gap", "undecided", "not-in-library") and not findings.unproven
    causes = causes_of(search, dataset, moved) if announced else ()
    doubts = [[rival.candidate.name for rival in one.doubts] for one in selection.chosen if announced]
    if findings.unproven:
        sizes = replace(sizes, recalibrated=search.recalibrated.gap, after=search.recalibrated.gap)
    learnable = None
    if (not causes or findings.remains) and not any(one.followed for one in problem.model.outputs):
        note("asking what any model could learn of what is left")
        learnable = _learnable(final.problem if causes else problem, final.z if causes else z)
    effects = final.problem.attached(final.problem.parameters(final.z))
    found: tuple[Place, ...] = ()
    missing: tuple[MissingForce, ...] = ()
    if places and (causes or decided == "not-in-library" or search.recalibrated.gap > floor):
        from labrun.gap.where.forces import missing_forces
        from labrun.gap.where.places import find_places

        note("looking where the gap is")
        difference = difference_of(search)
        found = find_places(difference, rng, note=note, each=each)
        if decided in ("not-in-library", "partly-explained"):
            missing = missing_forces(difference)
    rated = selection.rounds[0].rated
    nearest = max(rated, key=lambda one: one.share).candidate.name if rated else None
    channels = tuple((one.name, one.unit) for one in dataset.outputs)
    input_channels = tuple((one.name, one.unit) for one in dataset.inputs)
    differs = tuple(
        words(one, channels, problem.model.states, input_channels)
        for one in remaining(final.problem, final.z)
    )
    recalibrated, last = _named(problem, z), _named(final.problem, final.z)
    repeats = search.data.repeats
    return Diagnosis(
        name=dataset.name,
        model=problem.model.name,
        source=str(dataset.source),
        verdict=decided,
        differs=differs,
        sentence=sentence(
            decided,
            sizes,
            causes,
            shrunk,
            nearest,
            conditions=len(search.data.conditions),
            noise_known=noise.known,
            differs=differs,
            rest=decided == "explained" and findings.rest,
        ),
        gap=sizes,
        where=found,
        causes=causes,
        candidates=candidate_table(search, dataset, decided, causes),
        shrinkage=shrunk if causes else None,
        recalibration={
            one.name: (one.value, one.tolerance, recalibrated[one.name]) for one in problem.model.parameters
        },
        corrected=last if causes else recalibrated,
        effects=effects if causes else (),
        limitations=(
            *limitations(
                repeats=repeats,
                enough=_enough_repeats(search),
                conditions=len(search.data.conditions),
                basis=noise.basis,
                single_trial=len(dataset.trials) == 1,
                rejected=dataset.left_out,
            ),
            *search.limitations,
        ),
        notes=(
            *search.data.notes,
            *search.notes,
            *problem.model.notes,
            *search.remarks,
            *_unannounced(search, findings),
        ),
        what_next=tuple(what_next(decided, causes, doubts, repeats=repeats)),
        channels=channels,
        input_channels=input_channels,
        noise={one.name: float(sd) for one, sd in zip(dataset.outputs, noise.sd, strict=True)},
        trials=sum(one.count for one in search.data.trials),
        conditions=len(search.data.conditions),
        repeats=repeats,
        missing=missing,
        traces=traces_of(search, with_causes=bool(causes)),
        parameter_units={one.name: one.unit for one in problem.model.parameters},
        guard=_guard_words(search),
        seed=seed,
        seconds=elapsed_s(),
        learnable=learnable,
    )


def _learnable(problem: Problem, z: FloatArray) -> Learnable:
    several = len(problem.data.conditions) > 1
    return Learnable(
        learnable_share(problem, z), learnable_share(problem, z, conditions=True) if several else None
    )


def _enough_repeats(search: Search) -> bool:
    """Tell whether the repeats of some conditions tell the noise of all, as those of a search's leaders do."""
    most = max(one.count for one in search.data.trials)
    return search.noise.freedom >= criteria.ENOUGH_FREEDOM and most >= criteria.OWN_FLOOR_REPEATS


def _unannounced(search: Search, found: VerdictBasis) -> tuple[str, ...]:
    """Return what is said of causes that are not announced."""
    if not found.unproven or found.shrinkage is None:
        return ()
    names = " and ".join(str(one.name) for one in search.selection.chosen)
    return (
        f"{names} fits the recorded trials, but on withheld conditions it removes {100 * found.shrinkage.value:.0f} % "
        f"[{100 * found.shrinkage.low:.0f}, {100 * found.shrinkage.high:.0f}] of the gap, which may be nothing: "
        "it is not announced",
    )


def _guard_words(search: Search) -> str:
    """Return what an announced cause had to beat."""
    what = (
        "surrogates of the residual (its spectrum, phases at random)"
        if search.null.relative
        else "draws of the stated reading error"
        if search.noise.basis == "stated"
        else "draws of noise from the trials' own deviations"
    )
    told = (
        f"{criteria.NOISE_DRAWS} {what}, the whole library tried on each (linearised); an announced cause must "
        f"explain more than the best did in {criteria.NOISE_PERCENTILE:.0f} of 100"
    )
    return (
        f"{told}; {criteria.FULL_SEARCH_DRAWS} of them searched with all fits" if search.full_guard else told
    )


def _named(problem: Problem, z: FloatArray) -> dict[str, float]:
    """Return the model's parameters by name."""
    values = problem.model_parameters(z)
    return {one.name: float(value) for one, value in zip(problem.model.parameters, values, strict=True)}
