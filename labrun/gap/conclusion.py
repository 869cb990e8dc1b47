"""From what the search found to a diagnosis."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.notes import Note
from labrun.fit.problem import Problem
from labrun.fit.workers import Each, one_by_one
from labrun.gap import criteria
from labrun.gap.causes import candidate_table, causes_of
from labrun.gap.diagnosis import Diagnosis, MissingForce, Place, Shrinkage, Sizes
from labrun.gap.engine import Search
from labrun.gap.estimates import floor_of, scatter, shrinkage
from labrun.gap.excess import excess, mean_residuals
from labrun.gap.pictures import difference_of, traces_of
from labrun.gap.verdict import Findings, verdict
from labrun.gap.wording import limitations, sentence, what_next


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
    selection = search.selection
    floor = floor_of(search.units, noise, rng)
    if selection.chosen:
        sizes = Sizes(search.raw.gap, search.held_out.gap, selection.held_out.gap, floor)
    else:  # nothing to compare on withheld conditions, where extrapolated parameters alone would leave a gap
        sizes = Sizes(search.raw.gap, search.recalibrated.gap, search.recalibrated.gap, floor)
    shrunk: Shrinkage | None = None
    if selection.chosen:
        shrunk = shrinkage(search.units, noise, search.held_out_residual, selection.residual, rng)
    kinds = [one.candidate.name.kind for one in selection.chosen]
    findings = Findings(
        sizes,
        search.recalibrated.gap > floor,
        _remaining(search) > floor,
        noise.basis == "repeats",
        kinds.count("effect"),
        kinds.count("parameter"),
        shrunk,
    )
    decided = verdict(findings)
    moved = scatter(selection.final, search.draws)
    announced = decided not in ("no-gap", "not-in-library") and not findings.unproven
    causes = causes_of(search, dataset, moved) if announced else ()
    if findings.unproven:
        sizes = replace(sizes, recalibrated=search.recalibrated.gap, after=search.recalibrated.gap)
    effects = selection.final.problem.attached(selection.final.problem.parameters(selection.final.z))
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
    recalibrated, last = _named(problem, z), _named(selection.final.problem, selection.final.z)
    repeats = search.units.repeats
    return Diagnosis(
        name=dataset.name,
        model=problem.model.name,
        source=str(dataset.source),
        verdict=decided,
        sentence=sentence(decided, sizes, causes, shrunk, nearest, conditions=len(search.units.conditions)),
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
                conditions=len(search.units.conditions),
                basis=noise.basis,
                single_trial=len(dataset.trials) == 1,
                rejected=dataset.left_out,
            ),
            *search.limitations,
        ),
        notes=(
            *dataset.notes,
            *search.notes,
            *problem.model.notes,
            *search.remarks,
            *_unannounced(search, findings),
        ),
        what_next=tuple(what_next(decided, causes, repeats=repeats)),
        channels=tuple((one.name, one.unit) for one in dataset.outputs),
        input_channels=tuple((one.name, one.unit) for one in dataset.inputs),
        noise={one.name: float(sd) for one, sd in zip(dataset.outputs, noise.sd, strict=True)},
        trials=len(dataset.trials),
        conditions=len(search.units.conditions),
        repeats=repeats,
        missing=missing,
        traces=traces_of(search, with_causes=bool(causes)),
        parameter_units={one.name: one.unit for one in problem.model.parameters},
        guard=_guard_words(search),
        seed=seed,
        seconds=elapsed_s(),
    )


def _unannounced(search: Search, found: Findings) -> tuple[str, ...]:
    """Return what is said of causes that are not announced."""
    if not found.unproven or found.shrinkage is None:
        return ()
    names = " and ".join(str(one.candidate.name) for one in search.selection.chosen)
    return (
        f"{names} fits the recorded trials, but on withheld conditions it removes {100 * found.shrinkage.value:.0f} % "
        f"[{100 * found.shrinkage.low:.0f}, {100 * found.shrinkage.high:.0f}] of the gap, which may be nothing: "
        "it is not announced",
    )


def _remaining(search: Search) -> float:
    """Return the gap that the final model leaves, fitted to everything."""
    final = search.selection.final
    return excess(search.units, search.noise, mean_residuals(final.problem, final.z)).gap


def _guard_words(search: Search) -> str:
    """Return what an announced cause had to beat."""
    told = (
        f"{len(search.draws)} draws of noise from the trials' own deviations, the whole library tried on each "
        "(linearised); an announced cause must explain more than the best did in 97 of 100"
    )
    return (
        f"{told}; {criteria.FULL_SEARCH_DRAWS} of them searched with all fits" if search.full_guard else told
    )


def _named(problem: Problem, z: FloatArray) -> dict[str, float]:
    """Return the model's parameters by name."""
    values = problem.model_parameters(z)
    return {one.name: float(value) for one, value in zip(problem.model.parameters, values, strict=True)}
