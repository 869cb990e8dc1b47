"""From what the search found to a diagnosis."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.estimate import significant
from labrun.fit import Dataset, Each, Note, OutputNoise, Problem, one_by_one
from labrun.gap import criteria
from labrun.gap.candidates import Candidate as Tried
from labrun.gap.candidates import family
from labrun.gap.confidence import confidence, shrinkage, upper_bounds
from labrun.gap.diagnosis import (
    BeyondScatter,
    CandidateVerdict,
    Cause,
    ComparedTrace,
    Diagnosis,
    Learnable,
    MissingForce,
    Name,
    Place,
    RatedCandidate,
    ResampledNumber,
    Sizes,
    Verdict,
)
from labrun.gap.held_out import fitted_excess, floor_of, mean_residuals
from labrun.gap.intervals import effect_units, parameter_value, scatter, values_of
from labrun.gap.learnable import beyond_scatter, learnable_share
from labrun.gap.noise import from_residual
from labrun.gap.nuisance import information
from labrun.gap.other_laws import better_alone
from labrun.gap.pipeline import Search
from labrun.gap.rating import Rated
from labrun.gap.recalibration import member_residuals
from labrun.gap.screening import refit
from labrun.gap.selection import Chosen
from labrun.gap.trial_wise import remaining, words
from labrun.gap.verdict import (
    VerdictBasis,
    limitations,
    may_help_nothing,
    sentence,
    stands_all_the_same,
    verdict,
    what_next,
)
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
    law = _law_instead(search, selection.chosen, floor)
    findings = _basis(search, selection.chosen, floor, rng, law)
    unproven = may_help_nothing(findings)
    if unproven:
        without = _basis(search, (), floor, rng, _law_instead(search, (), floor))
        unproven = not stands_all_the_same(findings, without)
    unannounced = _unannounced(selection.chosen, findings) if unproven else ()
    findings = without if unproven else findings
    sizes, shrunk = findings.sizes, findings.shrinkage
    decided = verdict(findings)
    moved = scatter(final, search.null.draws(final))
    announced = decided not in ("no-gap", "undecided", "not-in-library") and not unproven
    causes = causes_of(search, dataset, moved) if announced else ()
    doubts = [[rival.candidate.name for rival in one.doubts] for one in selection.chosen if announced]
    learnable = None
    asked = search.candidates and (not causes or findings.remains)
    if asked and not any(one.followed for one in problem.model.outputs):
        note("asking what any model could learn of what is left")
        # what unannounced causes leave is not what the bare model leaves, of which it is asked then
        bare = selection.chosen and not causes and not unproven
        left = _basis(search, (), floor, rng, law) if bare else findings
        at = (final.problem, final.z) if causes else (problem, z)
        learnable = replace(_learnable(*at), why_no_noise=left.why_no_noise)
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
    best = [max(rated, key=lambda one: one.share).candidate.name] if rated else []
    nearest = best if shrunk is None else [one.name for one in selection.chosen]
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
            rest=findings.left_is_gap,
            better_alone=findings.better_alone,
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
            *unannounced,
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


def _basis(
    search: Search, chosen: Sequence[Chosen], floor: float, rng: np.random.Generator, law: str
) -> VerdictBasis:
    """Return what a verdict is made from: with the causes that were chosen, or without any; `law` explains more."""
    noise, end = search.noise, search.selection.final if chosen else search.recalibration
    if chosen:
        # where recalibration predicts worse than what is stated, nobody would recalibrate
        before = min(search.held_out.gap, search.raw.gap)
        sizes = Sizes(search.raw.gap, before, search.selection.held_out.gap, floor)
        shrunk = shrinkage(search.data, noise, search.held_out, search.selection.held_out, rng)
    else:  # nothing to compare on withheld conditions, where extrapolated parameters alone would leave a gap
        sizes = Sizes(search.raw.gap, search.recalibrated.gap, search.recalibrated.gap, floor)
        shrunk = None
    left, whole = fitted_excess(end.problem, end.z, noise), search.recalibrated.total
    remains = left.gap > floor
    kinds = [one.name.kind for one in chosen]
    basis = VerdictBasis(
        sizes,
        remains,
        noise.known,
        kinds.count("effect"),
        kinds.count("parameter"),
        shrunk,
        beyond_scatter(end.problem, end.z, noise) if remains else BeyondScatter(),
        len(search.dataset.trials),
        1.0 - left.total / whole if whole > 0.0 else 1.0,
        law,
    )
    return basis if shrunk is None else replace(basis, shrinkage=replace(shrunk, high=basis.most_removed))


def _law_instead(search: Search, chosen: Sequence[Chosen], floor: float) -> str:
    """Return the law that explains more without the causes than they do; where there are none, than any candidate does.

    It is not asked for beside parameters, whose form is the model's own, where motion follows what was measured, noise
    and all, in the many joints of a robot, and where a gap without causes is too small to be told.
    """
    selection, bare = search.selection, search.recalibration
    followed = any(one.followed for one in search.model.outputs)
    of_parameters = any(one.name.kind == "parameter" for one in chosen)
    if not search.candidates or followed or selection.final.brisk or of_parameters:
        return ""
    if not chosen and search.recalibrated.gap < criteria.SMALL_GAP_UNEXPLAINED:
        return ""
    at, beside = selection.rounds[-1 if chosen else 0], (selection.final.problem, selection.final.z)
    if not chosen:  # what promised too little was not fitted
        best = max(at.screened, key=lambda one: one.gain, default=bare)
        beside = best.problem, refit(best.problem, best.z)
    told = [rival.candidate.attached for one in chosen for rival, _ in one.rivals]
    return better_alone(
        beside,
        (bare.problem, bare.z),
        search.noise,
        at.threshold,
        floor,
        rivals=[one for one in told if one is not None],
    )


def _unannounced(chosen: Sequence[Chosen], found: VerdictBasis) -> tuple[str, ...]:
    """Return what is said of causes that are not announced."""
    if found.shrinkage is None:
        return ()
    names = " and ".join(str(one.name) for one in chosen)
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


def causes_of(search: Search, dataset: Dataset, moved: FloatArray) -> tuple[Cause, ...]:
    """Return the causes that were chosen, with sizes and 95 % intervals from the final fit."""
    final = search.selection.final
    model = final.problem.model
    found = []
    for one in search.selection.chosen:
        name = one.name
        if name.kind == "parameter":
            values = parameter_value(final.problem, final.z, name.effect, moved, model)
            stated = next(parameter.value for parameter in model.parameters if parameter.name == name.effect)
            remark = f"{values[name.effect].value / stated:.3g} times the stated value" if stated else ""
        else:
            place = _place(search, name)
            values = values_of(final.problem, final.z, place, moved, model, dataset)
            remark = "; ".join(
                filter(
                    None,
                    (_bound_remark(search, place), _form_remark(one), _caution(one.rated), _kinship(one)),
                )
            )
        found.append(
            Cause(
                name,
                confidence(search, one),
                values,
                tuple(rival.candidate.name for rival, _ in one.rivals[:1]),
                remark,
            )
        )
    return tuple(found)


def _kinship(one: Chosen) -> str:
    """Return the family of a cause and its rivals, where they have one."""
    shared = next(filter(None, (family(one.name, rival.candidate.name) for rival, _ in one.rivals)), "")
    return f"{shared}: what mends one of the forms mends the other" if shared else ""


def _form_remark(one: Chosen) -> str:
    """Return which shapes are not the usual ones, since others fit better."""
    usual, fitted = one.rated.screened.usual, one.rated.candidate.attached
    if usual is None or usual.candidate.attached is None or fitted is None:
        return ""
    freed = [
        f"{was.name} {significant(was.starts[0])}"
        for was, now in zip(usual.candidate.attached.effect.parameters, fitted.effect.parameters, strict=True)
        if was.held and not now.held and was.quantity == "ratio"
    ]
    return f"the usual form, with {' and '.join(freed)}, fits worse" if freed else ""


def _caution(one: Rated) -> str:
    attached = one.candidate.attached
    return "" if attached is None else attached.effect.caution


def candidate_table(
    search: Search, dataset: Dataset, decided: Verdict, causes: tuple[Cause, ...]
) -> tuple[RatedCandidate, ...]:
    """Return what was found about every candidate, the most telling first."""
    first, last = search.selection.rounds[0], search.selection.rounds[-1]
    rated = {one.candidate.name: one for one in first.rated}
    chosen = {cause.name: cause for cause in causes}
    rivals: dict[Name, list[Name]] = {}
    for one in search.selection.chosen if causes else ():
        for rival, _ in one.rivals:
            rivals.setdefault(rival.candidate.name, []).append(one.name)
    told = _far_off(search)
    found = []
    for candidate in search.candidates:
        name = candidate.name
        screened = last.find(candidate) or first.find(candidate)
        if screened is None:
            continue
        there = last if last.find(candidate) else first
        early = first.find(candidate) or screened
        visible = screened.visible**2 if name.kind == "effect" else told[name.effect]
        seen = max(visible, early.gain) > there.threshold.gain
        judged = _judged(name, chosen, rivals, seen=seen)
        bounds: dict[str, ResampledNumber] = {}
        if judged == "ruled-out" and candidate.attached is not None:
            units = effect_units(candidate.attached, search.model, dataset)
            bounds = upper_bounds(screened, there.base, there.threshold.dispersion, units)
        found.append(
            RatedCandidate(
                name,
                judged,
                rated[name].share if name in rated else None,
                first.threshold.evidence(early.gain),
                chosen[name].values if name in chosen else {},
                bounds,
                chosen[name].indistinguishable_from if name in chosen else tuple(rivals.get(name, ())),
                _remark(judged, decided, _richer_than(candidate, chosen), several=len(chosen) > 1)
                or (_searched(candidate, search, dataset) if judged == "ruled-out" else ""),
            )
        )
    rank = {"cause": 0, "indistinguishable": 1, "ruled-out": 2, "not-visible": 3}
    return tuple(sorted(found, key=lambda one: (rank[one.verdict], -one.evidence)))


def _far_off(search: Search) -> dict[str, float]:
    """Return by how much the sum of squares would grow were a parameter as far off as its statement allows."""
    base = search.selection.rounds[0].base
    problem = base.problem
    known = information(problem, base.z, base.nuisance.jacobian)
    return {
        name: float(
            max(one * (sigma / scale) ** 2 - 1.0, 0.0) * criteria.WITHIN_TOLERANCES**2
        )  # less what is known without data
        for name, one, sigma, scale in zip(
            problem.priors.names, known, problem.priors.sigma, problem.priors.scale, strict=False
        )
    }


def _judged(
    name: Name, chosen: dict[Name, Cause], rivals: dict[Name, list[Name]], *, seen: bool
) -> CandidateVerdict:
    if name in chosen:
        return "cause"
    if name in rivals:
        return "indistinguishable"
    return "ruled-out" if seen else "not-visible"


def _richer_than(one: Tried, chosen: dict[Name, Cause]) -> str:
    """Return the cause at its site that a candidate contains; empty if none."""
    contained = () if one.attached is None else one.attached.effect.contains
    return next((str(name) for name in chosen if name.site == one.name.site and name.effect in contained), "")


def _remark(judged: CandidateVerdict, decided: Verdict, contained: str = "", *, several: bool = False) -> str:
    if judged == "ruled-out" and contained and several:
        return f"looks nearly the same as {contained} and the other cause together"
    if judged == "ruled-out" and contained:
        return f"contains {contained}, and what it has more explains nothing"
    if judged == "not-visible":
        return "what it changes at the sizes tried is nearly all imitated by parameters"
    if judged == "ruled-out" and decided == "not-in-library":
        return "does not explain enough of the gap on conditions it did not see"
    return ""


def _searched(candidate: Tried, search: Search, dataset: Dataset) -> str:
    """Return the range of sizes that were tried: beyond it nothing is ruled out."""
    attached, scale = candidate.attached, candidate.scale
    if attached is None or scale is None:
        return ""
    units = effect_units(attached, search.model, dataset)
    ranges = [
        f"{one.name} {significant(low)} to {significant(high)} {units[one.name]}".removesuffix(" 1")
        for one in attached.effect.parameters
        if not one.held
        for low, high in [one.bounds(scale)]
    ]
    return f"searched: {', '.join(ranges)}"


def _place(search: Search, name: Name) -> int:
    effects = search.selection.final.problem.effects
    kinds = [(one.effect.id, one.site) for one in effects]
    return kinds.index((name.effect, name.site))


def _bound_remark(search: Search, place: int) -> str:
    final = search.selection.final
    variable = final.problem.size - sum(
        not one.held for other in final.problem.effects[place:] for one in other.effect.parameters
    )
    at_bounds = []
    for parameter in final.problem.effects[place].effect.parameters:
        if parameter.held:
            continue
        within = np.array([parameter.lower, final.z[variable], parameter.upper])
        if parameter.lower > 0.0:  # what spans decades is searched in proportion
            within = np.log(within)
        low, value, high = within
        if min(abs(value - low), abs(high - value)) < criteria.AT_BOUND * (high - low):
            at_bounds.append(parameter.name)
        variable += 1
    if not at_bounds:
        return ""
    return f"{' and '.join(at_bounds)} ended at a bound of what is searched: take it as a direction, not as a size"
