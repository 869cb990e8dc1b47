"""What is told of causes and of every other candidate: sizes, rivals, what is ruled out up to which size, remarks."""

import numpy as np

from labrun.arrays import FloatArray
from labrun.estimate import significant
from labrun.fit import Dataset
from labrun.gap import criteria
from labrun.gap.candidates import Candidate as Tried
from labrun.gap.confidence import confidence, upper_bounds
from labrun.gap.diagnosis import CandidateVerdict, Cause, Name, RatedCandidate, ResampledNumber, Verdict
from labrun.gap.intervals import effect_units, parameter_value, values_of
from labrun.gap.kin import family
from labrun.gap.nuisance import information
from labrun.gap.pipeline import Search
from labrun.gap.rating import Rated
from labrun.gap.selection import Chosen


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
